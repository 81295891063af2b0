//! `luxel cache`: what the stores hold.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use luxel::store::{self, Bad, Collected, Kind, Stat, Store, StoreError, Usage, Verified};
use luxel::text::{plain, shown};
use luxel_scene::{Progress, Silent};
use serde_json::{Value, json};

use super::amount::{ago, bytes};
use super::args::{Cache, CacheTask, Gc, Places};
use super::print::{self, written};
use super::progress::{Reporter, Style, event, out, say};
use super::{DONE, SOME_FAILED};

/// What became of one store.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct End {
    /// Damaged files that are still there.
    bad: usize,
    /// It could not be cleaned wholly.
    failed: bool,
}

/// Does the task for every store that is meant; one that cannot be looked through stops no other.
pub fn cache(args: &Cache) -> anyhow::Result<u8> {
    let places = args.places();
    let stores = stores(places)?;
    if stores.is_empty() && !places.json {
        say("no store there: bakes make one, .luxel/ beside their outputs or as --store says");
    }
    let (mut bad, mut failed) = (0, 0);
    for folder in &stores {
        match run(&args.task, &Store::new(folder), places.json) {
            Ok(end) => {
                bad += end.bad;
                failed += usize::from(end.failed);
            }
            Err(error) => {
                failed += 1;
                tell_failure(folder, error, places.json);
            }
        }
    }
    if places.json {
        event(&json!({ "event": "done", "stores": stores.len(), "failed": failed, "bad": bad }));
    }
    Ok(if bad + failed == 0 { DONE } else { SOME_FAILED })
}

/// The stores of a command line. One that is named is meant even where there is none yet.
fn stores(places: &Places) -> anyhow::Result<Vec<PathBuf>> {
    let here = [PathBuf::from(".")];
    let paths = if places.paths.is_empty() && places.store.is_none() { &here[..] } else { &places.paths };
    let mut stores = store::find(paths)?;
    if let Some(named) = &places.store {
        let meta = std::fs::metadata(named);
        anyhow::ensure!(meta.is_ok_and(|m| m.is_dir()), "{}: there is no such folder; check --store", named.display());
        let real = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.into());
        if !stores.iter().any(|store| real(store) == real(named)) {
            stores.push(named.clone());
        }
    }
    Ok(stores)
}

fn run(task: &CacheTask, store: &Store, json: bool) -> Result<End, StoreError> {
    if !json {
        match task {
            CacheTask::Stat(_) => out(&format!("{}\n", shown(store.folder()))),
            _ => say(&shown(store.folder())),
        }
    }
    match task {
        CacheTask::Stat(_) => {
            let (stat, cap) = (store.stat()?, store.cap());
            let kept = store.kept_cap().ok().flatten().is_some();
            tell_stat(store.folder(), &stat, (cap.as_ref().ok().copied(), kept), json);
            cap.map(|_| End::default())
        }
        CacheTask::Verify(_) => {
            let verified = watched(store, json, |progress| store.verify(progress))?;
            tell_verified(store.folder(), &verified, json);
            Ok(End { bad: verified.bad.len(), failed: false })
        }
        CacheTask::Gc(Gc { cap, older, .. }) => {
            if let Some(cap) = *cap {
                Store::new(store.folder()).with_cap(cap).keep_cap()?;
            }
            let cap = cap.map_or_else(|| store.cap(), Ok)?;
            let collected = watched(store, json, |progress| store.gc(cap, *older, progress))?;
            tell_collected(store.folder(), &collected, json);
            Ok(End { bad: 0, failed: !collected.failed.is_empty() })
        }
    }
}

/// Shows a person how far it has got.
fn watched<T>(store: &Store, json: bool, work: impl FnOnce(&dyn Progress) -> T) -> T {
    if json {
        return work(&Silent);
    }
    let reporter = Reporter::new(Style::choose(false, false), &written(store.folder()), Arc::default());
    let done = work(&reporter);
    reporter.finish();
    done
}

fn tell_failure(folder: &Path, error: StoreError, json: bool) {
    let error = anyhow::Error::new(error);
    if json {
        let causes: Vec<String> = error.chain().skip(1).map(ToString::to_string).collect();
        event(&json!({ "event": "failed", "store": written(folder), "error": error.to_string(), "causes": causes }));
    } else {
        print::failure(Some(folder), &error);
    }
}

/// `cap` [bytes] is None where the store's own cannot be read; it is the default unless it is `kept`.
fn tell_stat(folder: &Path, stat: &Stat, (cap, kept): (Option<u64>, bool), json: bool) {
    if json {
        let kinds: serde_json::Map<String, Value> =
            stat.kinds.iter().map(|(kind, usage)| (kind.name().into(), with_times(usage))).collect();
        return event(&json!({
            "event": "stat",
            "store": written(folder),
            "cap": cap,
            "kept": kept,
            "total": with_times(&stat.total),
            "kinds": kinds,
            "leftovers": with_times(&stat.leftovers),
            "old": with_times(&stat.old),
        }));
    }
    let now = SystemTime::now();
    let row = |name: &str, usage: &Usage| {
        let since = |time: SystemTime| ago(now.duration_since(time).unwrap_or(Duration::ZERO));
        let used = match (usage.newest, usage.oldest) {
            (Some(newest), Some(oldest)) => format!("{} to {} ago", since(newest), since(oldest)),
            _ => "never".into(),
        };
        format!("  {name:<10} {:>7} {:>10}   {used}\n", usage.files, bytes(usage.bytes))
    };
    let mut text = format!("  {:<10} {:>7} {:>10}   last used\n", "", "files", "size");
    for (kind, usage) in Kind::ALL.iter().filter_map(|kind| Some((kind, stat.kinds.get(kind)?))) {
        text += &row(kind.name(), usage);
    }
    text += &row("total", &stat.total);
    if let Some(cap) = cap {
        let whose = if kept { "" } else { "   the default: it was told none" };
        text += &format!("  {:<10} {:>7} {:>10}{whose}\n", "cap", "", bytes(cap));
    }
    for (usage, what) in [
        (&stat.leftovers, "temporary files: being written, or left by killed bakes; gc removes those"),
        (&stat.old, "octrees of an earlier luxel; gc removes them"),
    ] {
        if usage.files > 0 {
            text += &format!("  {} ({}) {what}\n", usage.files, bytes(usage.bytes));
        }
    }
    out(&text);
}

fn tell_verified(folder: &Path, verified: &Verified, json: bool) {
    let Verified { sound, outdated, bad } = verified;
    for (files, word) in [(outdated, "outdated"), (bad, "bad")] {
        for Bad { path, why } in files {
            if json {
                event(&json!({ "event": word, "store": written(folder), "file": written(path), "reason": why }));
            } else {
                say(&format!("  {word}: {}: {}", shown(path), plain(why)));
            }
        }
    }
    if json {
        return event(&json!({
            "event": "verified", "store": written(folder),
            "sound": sound.files, "outdated": outdated.len(), "bad": bad.len(),
        }));
    }
    say(&format!("  {} sound ({}), {} outdated, {} bad", sound.files, bytes(sound.bytes), outdated.len(), bad.len()));
    if !bad.is_empty() {
        say("  luxel cache gc removes bad files and empty folders; a bake makes anew what it needs of them");
    }
}

fn tell_collected(folder: &Path, collected: &Collected, json: bool) {
    let Collected { evicted, bad, outdated, leftovers, left, failed } = collected;
    if json {
        let short = |usage: &Usage| json!({ "files": usage.files, "bytes": usage.bytes });
        let failed: Vec<Value> =
            failed.iter().map(|Bad { path, why }| json!({ "file": written(path), "reason": why })).collect();
        return event(&json!({
            "event": "collected", "store": written(folder), "evicted": short(evicted), "bad": short(bad),
            "outdated": short(outdated), "leftovers": short(leftovers), "left": short(left), "failed": failed,
        }));
    }
    let parts = [(evicted, "unused"), (bad, "bad"), (outdated, "outdated"), (leftovers, "temporary")];
    for (usage, what) in parts.into_iter().filter(|(usage, _)| usage.files > 0) {
        say(&format!("  removed {} {what} ({})", usage.files, bytes(usage.bytes)));
    }
    for Bad { path, why } in failed {
        say(&format!("  error: cannot remove {}: {}", shown(path), plain(why)));
    }
    say(&format!("  {} left ({})", left.files, bytes(left.bytes)));
}

fn with_times(usage: &Usage) -> Value {
    let seconds = |time: Option<SystemTime>| {
        time.and_then(|time| time.duration_since(SystemTime::UNIX_EPOCH).ok()).map(|since| since.as_secs())
    };
    json!({
        "files": usage.files, "bytes": usage.bytes,
        "oldest": seconds(usage.oldest), "newest": seconds(usage.newest),
    })
}
