//! Embeds the preview page where it was built (`npm ci && npm run build` in assets/preview); luxel builds without it
//! as well, and then says what is missing when a preview is asked for.

use std::path::{Path, PathBuf};
use std::{env, fs, io};

/// The files of the page: all of them, or none.
const PARTS: [&str; 3] = ["index.html", "preview.js", "preview.css"];

fn main() -> io::Result<()> {
    // The folder is always there, so that cargo can see the page come and go in it.
    println!("cargo::rerun-if-changed=assets/preview/dist");
    let variable = |name: &str| env::var_os(name).map(PathBuf::from).ok_or_else(|| io::Error::other(name.to_owned()));
    let built = variable("CARGO_MANIFEST_DIR")?.join("assets/preview/dist");
    let is_whole = PARTS.iter().all(|name| built.join(name).is_file());
    let parts: String = PARTS.iter().filter(|_| is_whole).map(|name| entry(&built, name)).collect();
    fs::write(variable("OUT_DIR")?.join("bundle.rs"), format!("&[{parts}]"))
}

fn entry(folder: &Path, name: &str) -> String {
    let path = folder.join(name);
    format!("({name:?}, include_bytes!({:?}) as &[u8]),", path.display().to_string())
}
