//! Writes the scenes that luxel ships: `cargo run -p luxel-assets [FOLDER]`, by default into `assets/`.

use std::path::PathBuf;

use anyhow::Context;

fn main() -> anyhow::Result<()> {
    let home = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    let folder = std::env::args_os().nth(1).map_or_else(|| PathBuf::from(home), PathBuf::from);
    for (name, scene) in luxel_assets::all() {
        let path = folder.join(format!("{name}.glb"));
        let bytes = luxel_assets::glb::write(&scene).with_context(|| format!("scene {name}"))?;
        std::fs::write(&path, &bytes).with_context(|| format!("cannot write {}", path.display()))?;
        println!("{}: {} triangles, {} bytes", path.display(), scene.triangle_count(), bytes.len());
    }
    Ok(())
}
