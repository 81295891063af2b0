//! What a test does where the machine refuses what it needs.

/// Says why a test has seen nothing. With `LUXEL_NO_SKIP=1` that is a failure: for machines that are known to have
/// everything.
pub fn skipped(why: &str) {
    assert!(std::env::var_os("LUXEL_NO_SKIP").is_none_or(|value| value != "1"), "skipped: {why}");
    println!("skipped: {why}");
}

/// A command that runs another with a file system of its own mounts, as root or as somebody who may pretend to be.
#[cfg(target_os = "linux")]
pub fn mounting() -> Option<std::process::Command> {
    let ways = [&["--mount"][..], &["--map-root-user", "--mount"]];
    ways.into_iter().find_map(|way| {
        let mut probe = std::process::Command::new("unshare");
        let probe = probe.args(way).args(["mount", "-t", "tmpfs", "luxel", "/tmp"]).output();
        probe.ok().filter(|probe| probe.status.success())?;
        let mut command = std::process::Command::new("unshare");
        command.args(way);
        Some(command)
    })
}

/// Whether permissions keep this process from writing into a folder that may only be read.
pub fn is_bound(folder: &std::path::Path) -> bool {
    let probe = folder.join("probe");
    let is_bound = std::fs::write(&probe, "x").is_err();
    assert!(is_bound || std::fs::remove_file(probe).is_ok());
    is_bound
}

/// A command that runs another as somebody whom the permissions of files bind: root without its privileges.
#[cfg(unix)]
pub fn unprivileged() -> Option<std::process::Command> {
    let bare = || {
        let mut command = std::process::Command::new("setpriv");
        command.args(["--bounding-set=-all", "--inh-caps=-all", "--"]);
        command
    };
    bare().arg("true").output().ok().filter(|probe| probe.status.success()).map(|_| bare())
}
