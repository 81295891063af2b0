//! Where the files of a bake go, what they are called, and in which order they appear.

use std::{
    fs,
    io::{self, Write},
    path::{Path, PathBuf},
};

use luxel_scene::{Progress, Watched};
use rayon::prelude::*;

use crate::{
    BoundMap, Depth, Effort, ExportError, Lightmap,
    atomic::{self, Staged},
    openexr::Exr,
    report::{Output, Report},
};

/// Folder beside a scene that receives its outputs unless another is named.
pub const DEFAULT_FOLDER: &str = "baked";

/// No report is larger than this.
const MAX_REPORT: u64 = 64 << 20;

/// The names of all files of one bake.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OutputSet {
    folder: PathBuf,
    stem: String,
}

/// The images of a bake.
pub struct Images<'a> {
    pub lightmaps: &'a [Lightmap],
    /// Empty, or one image per page.
    pub bounds: &'a [BoundMap],
    pub depth: Depth,
    /// What the images are encoded with.
    pub effort: Effort,
    /// Hash of what went into the bake, written into the images.
    pub key: &'a str,
    /// The encoded preview picture.
    pub preview_png: Option<&'a [u8]>,
}

/// Images that are on the disk under temporary names; they go when this is dropped.
#[derive(Default)]
pub struct StagedImages(Vec<Filed>);

/// A file under its temporary name, and what a report says of it.
struct Filed {
    file: Staged,
    output: Output,
}

impl OutputSet {
    /// Places the outputs of `scene`: in `out`, or in `baked/` beside the scene. `root` is the folder that was
    /// scanned, if one was: subfolders below it are mirrored below `out`. When `a.gltf` and `a.glb` lie side by side,
    /// their outputs keep the extension in the stem. Refuses to write over the scene itself.
    pub fn new(scene: &Path, out: Option<&Path>, root: Option<&Path>) -> Result<Self, ExportError> {
        let place = |fault: &str| ExportError::Place { path: scene.into(), fault: fault.into() };
        let parent = scene.parent().unwrap_or(Path::new(""));
        let utf8 = |s: &std::ffi::OsStr| s.to_str().map(str::to_owned).ok_or_else(|| place("the name is not UTF-8"));
        let name = utf8(scene.file_name().ok_or_else(|| place("this is not a file name"))?)?;
        let stem = utf8(scene.file_stem().unwrap_or_default())?;
        let folder = match (out, root) {
            (None, _) => parent.join(DEFAULT_FOLDER),
            (Some(out), None) => out.into(),
            (Some(out), Some(root)) => {
                out.join(parent.strip_prefix(root).map_err(|_| place("the scene is not below the scanned folder"))?)
            }
        };
        let twin = |e: &str| {
            scene.extension().is_some_and(|own| !own.eq_ignore_ascii_case(e))
                && parent.join(format!("{stem}.{e}")).exists()
        };
        let set = Self { folder, stem: if twin("glb") || twin("gltf") { name } else { stem } };
        let same = |a: &Path, b: &Path| match (a.canonicalize(), b.canonicalize()) {
            (Ok(a), Ok(b)) => a == b,
            _ => a == b,
        };
        if same(&set.glb(), scene) {
            return Err(place("the output would replace the scene itself: choose another folder with --out"));
        }
        Ok(set)
    }

    pub fn folder(&self) -> &Path {
        &self.folder
    }

    pub fn stem(&self) -> &str {
        &self.stem
    }

    fn file(&self, rest: &str) -> PathBuf {
        self.folder.join(format!("{}.{rest}", self.stem))
    }

    fn paged(&self, kind: &str, page: usize, pages: usize) -> PathBuf {
        if pages == 1 { self.file(&format!("{kind}.exr")) } else { self.file(&format!("{kind}.{page}.exr")) }
    }

    /// The scene with its lightmap.
    pub fn glb(&self) -> PathBuf {
        self.file("glb")
    }

    /// Irradiance of one page of `pages`.
    pub fn lightmap(&self, page: usize, pages: usize) -> PathBuf {
        self.paged("lightmap", page, pages)
    }

    /// Stated bound of one page of `pages`.
    pub fn bound(&self, page: usize, pages: usize) -> PathBuf {
        self.paged("bound", page, pages)
    }

    pub fn preview(&self) -> PathBuf {
        self.file("preview.png")
    }

    pub fn report(&self) -> PathBuf {
        self.file("bake.json")
    }

    /// A picture as it is displayed, and its radiance.
    pub fn render(&self) -> (PathBuf, PathBuf) {
        (self.file("render.png"), self.file("render.exr"))
    }

    /// Pictures by several methods side by side.
    pub fn compare(&self) -> PathBuf {
        self.file("compare.png")
    }

    /// Names (without folder) of the lightmap files, as the glb refers to them.
    pub fn lightmap_names(&self, pages: usize) -> Vec<String> {
        (0..pages).filter_map(|p| self.lightmap(p, pages).file_name()?.to_str().map(str::to_owned)).collect()
    }

    /// Sees that no folder lies where a file of a bake would: neither can it take its place, nor be tidied away later.
    ///
    /// # Errors
    /// Names the folder.
    pub fn check_names(&self) -> Result<(), ExportError> {
        let named = |path: &PathBuf| {
            let own = [self.glb(), self.report()].contains(path);
            own || path.file_name().and_then(|n| n.to_str()).is_some_and(|n| self.is_image_name(n))
        };
        match self.listed()?.into_iter().find(|path| path.is_dir() && named(path)) {
            Some(path) => {
                let fault = "a folder lies where a file of the bake would: move it, or choose another place with --out";
                Err(ExportError::Place { path, fault: fault.into() })
            }
            None => Ok(()),
        }
    }

    /// Writes images under temporary names, several at a time. They are encoded straight into their files, a few rows
    /// at a time. What an image cannot hold is seen before the first is written.
    pub fn stage(&self, images: &Images, progress: &dyn Progress) -> Result<StagedImages, ExportError> {
        self.stage_by(images, progress, &|content, file| content.write(&mut Watched::new(file, progress)))
    }

    /// Writes the glb, and last the report, which thereby lists the hashes of all the others, and puts everything in its
    /// place. All files are complete and on the disk under temporary names before the first takes its place: when one
    /// cannot be written, all old ones stay. Images of an earlier bake that this one has not (other pages, no bound, no
    /// preview) are removed last.
    ///
    /// Cancelled it can be until then: no temporary file is left, and no output is touched. Nothing interrupts the
    /// flushing of one file to the disk.
    pub fn write(
        &self,
        images: StagedImages,
        glb: &[u8],
        report: &mut Report,
        progress: &dyn Progress,
    ) -> Result<(), ExportError> {
        self.write_by(images, glb, report, progress, &|content, file| content.write(&mut Watched::new(file, progress)))
    }

    fn stage_by(&self, images: &Images, progress: &dyn Progress, fill: &Fill) -> Result<StagedImages, ExportError> {
        let contents = self.contents(images)?;
        let filed = contents.par_iter().map(|(path, content)| filed(path, content, progress, fill));
        Ok(StagedImages(filed.collect::<Result<_, ExportError>>()?))
    }

    fn write_by(
        &self,
        StagedImages(mut files): StagedImages,
        glb: &[u8],
        report: &mut Report,
        progress: &dyn Progress,
        fill: &Fill,
    ) -> Result<(), ExportError> {
        files.push(filed(&self.glb(), &Content::Bytes(glb), progress, fill)?);
        let report_path = self.report();
        let stale = self.stale(&files.iter().map(|f| f.file.path()).chain([&*report_path]).collect::<Vec<_>>())?;
        let mut staged = Vec::new();
        report.outputs.clear();
        for Filed { file, output } in files {
            report.outputs.push(output);
            staged.push(file);
        }
        let json = Content::Bytes(&report.to_json()?);
        staged.push(atomic::stage(&report_path, |file| fill(&json, file))?);
        // From here on the old files are replaced.
        progress.check()?;
        atomic::persist(staged)?;
        for path in stale {
            std::fs::remove_file(&path).map_err(|e| ExportError::io("remove the outdated", &path, e))?;
        }
        Ok(())
    }

    /// All images, in the order of writing. What one cannot hold is seen here.
    fn contents<'a>(&self, files: &Images<'a>) -> Result<Vec<(PathBuf, Content<'a>)>, ExportError> {
        let pages = files.lightmaps.len();
        let mut contents = Vec::new();
        for (i, map) in files.lightmaps.iter().enumerate() {
            contents.push((
                self.lightmap(i, pages),
                Content::Exr(Exr::lightmap(map, files.depth, files.key)?.with(files.effort)),
            ));
        }
        for (i, map) in files.bounds.iter().enumerate() {
            contents.push((
                self.bound(i, pages),
                Content::Exr(Exr::bound(map, files.depth, files.key)?.with(files.effort)),
            ));
        }
        if let Some(png) = files.preview_png {
            contents.push((self.preview(), Content::Bytes(png)));
        }
        Ok(contents)
    }

    /// Lightmap, bound and preview images in the folder that bear this stem's name and are not among `current`: left
    /// over from another bake.
    ///
    /// # Errors
    /// The folder cannot be listed.
    pub fn stale(&self, current: &[impl AsRef<Path>]) -> Result<Vec<PathBuf>, ExportError> {
        let outdated = |path: &PathBuf| {
            let name = path.file_name();
            let is_image = name.and_then(|n| n.to_str()).is_some_and(|n| self.is_image_name(n));
            is_image && !current.iter().any(|c| c.as_ref().file_name() == name)
        };
        Ok(self.listed()?.into_iter().filter(outdated).collect())
    }

    /// What lies in the folder, sorted; nothing where there is none.
    fn listed(&self) -> Result<Vec<PathBuf>, ExportError> {
        let failed = |e| ExportError::io("list the folder", &self.folder, e);
        let entries = match fs::read_dir(&self.folder) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries.map_err(failed)?,
        };
        let mut listed = entries.map(|e| e.map(|e| e.path())).collect::<io::Result<Vec<_>>>().map_err(failed)?;
        listed.sort();
        Ok(listed)
    }

    /// `stem.lightmap.exr`, `stem.bound.3.exr`, `stem.preview.png` and the like.
    fn is_image_name(&self, name: &str) -> bool {
        let Some(rest) = name.strip_prefix(&self.stem).and_then(|r| r.strip_prefix('.')) else { return false };
        let Some(rest) = rest.strip_suffix(".exr") else { return rest == "preview.png" };
        ["lightmap", "bound"].iter().any(|kind| {
            rest.strip_prefix(kind).is_some_and(|page| {
                page.is_empty()
                    || page.strip_prefix('.').is_some_and(|p| !p.is_empty() && p.bytes().all(|b| b.is_ascii_digit()))
            })
        })
    }
}

/// The .glb at `path` came out of a bake: the report beside it names it. Scans of a folder pass such files over.
pub fn is_output(path: &Path) -> bool {
    let stem = path.file_stem().and_then(|s| s.to_str());
    let Some(report) = stem.map(|s| path.with_file_name(format!("{s}.bake.json"))) else { return false };
    let small = |m: std::fs::Metadata| m.is_file() && m.len() <= MAX_REPORT;
    if !std::fs::metadata(&report).is_ok_and(small) {
        return false;
    }
    let read = std::fs::read(&report).ok().and_then(|bytes| serde_json::from_slice::<Report>(&bytes).ok());
    read.is_some_and(|r| r.outputs.iter().any(|o| path.file_name().is_some_and(|n| n == o.path.as_str())))
}

/// What a file is to hold.
enum Content<'a> {
    Exr(Exr<'a>),
    Bytes(&'a [u8]),
}

impl Content<'_> {
    fn write(&self, file: &mut (impl Write + io::Seek)) -> io::Result<()> {
        match self {
            Self::Exr(exr) => exr.write(&mut io::BufWriter::new(file)),
            Self::Bytes(bytes) => file.write_all(bytes),
        }
    }
}

/// Puts a content into a file.
type Fill<'f> = dyn Fn(&Content, &mut fs::File) -> io::Result<()> + Sync + 'f;

/// Writes a file under a temporary name.
fn filed(path: &Path, content: &Content, progress: &dyn Progress, fill: &Fill) -> Result<Filed, ExportError> {
    let mut file = atomic::stage(path, |file| fill(content, file))?;
    let (bytes, hash) = file.fingerprint(progress)?;
    let path = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(Filed { file, output: Output { path, bytes, blake3: hash.to_hex().to_string() } })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::atomic::tests::names;
    use crate::report::SceneInfo;
    use glam::Vec3;
    use luxel_scene::Silent;
    use std::sync::atomic::{AtomicUsize, Ordering};

    fn write(set: &OutputSet, pages: usize) -> Report {
        let map = Lightmap::new(2, 1, vec![Vec3::ONE; 2], vec![1.0; 2]).unwrap();
        let bound = BoundMap::new(2, 1, vec![0.1; 2]).unwrap();
        let files = Images {
            lightmaps: &vec![map; pages],
            bounds: &vec![bound; pages],
            depth: Depth::Float,
            effort: Effort::Small,
            key: "k",
            preview_png: Some(b"png"),
        };
        let mut report = Report::new(SceneInfo::default());
        set.write(set.stage(&files, &Silent).unwrap(), b"glb", &mut report, &Silent).unwrap();
        report
    }

    #[test]
    fn names_follow_the_contract() {
        let set = OutputSet::new(Path::new("maps/level.glb"), None, None).unwrap();
        assert_eq!(set.glb(), Path::new("maps/baked/level.glb"));
        assert_eq!(set.lightmap(0, 1), Path::new("maps/baked/level.lightmap.exr"));
        assert_eq!(set.lightmap(1, 2), Path::new("maps/baked/level.lightmap.1.exr"));
        assert_eq!(set.bound(0, 1), Path::new("maps/baked/level.bound.exr"));
        assert_eq!(set.preview(), Path::new("maps/baked/level.preview.png"));
        assert_eq!(set.report(), Path::new("maps/baked/level.bake.json"));
        let out = OutputSet::new(Path::new("maps/a/level.v2.glb"), Some(Path::new("out")), Some(Path::new("maps")));
        assert_eq!(out.unwrap().glb(), Path::new("out/a/level.v2.glb"));
        assert!(OutputSet::new(Path::new("x/a.glb"), Some(Path::new("out")), Some(Path::new("maps"))).is_err());
    }

    #[test]
    fn twins_keep_their_extension_and_a_scene_is_never_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let (glb, gltf) = (dir.path().join("a.glb"), dir.path().join("a.gltf"));
        fs::write(&glb, b"x").unwrap();
        assert_eq!(OutputSet::new(&glb, None, None).unwrap().stem(), "a");
        fs::write(&gltf, b"x").unwrap();
        assert_eq!(OutputSet::new(&glb, None, None).unwrap().stem(), "a.glb");
        assert_eq!(OutputSet::new(&gltf, None, None).unwrap().stem(), "a.gltf");
        fs::remove_file(&gltf).unwrap();
        let error = OutputSet::new(&glb, Some(&dir.path().join(".")), None).unwrap_err().to_string();
        assert!(error.contains("replace the scene itself"), "{error}");
    }

    #[test]
    fn the_report_is_last_and_lists_the_hashes_of_what_lies_there() {
        let dir = tempfile::tempdir().unwrap();
        let set = OutputSet::new(&dir.path().join("level.glb"), None, None).unwrap();
        let report = write(&set, 1);
        let listed: Vec<_> = report.outputs.iter().map(|o| o.path.as_str()).collect();
        assert_eq!(listed, ["level.lightmap.exr", "level.bound.exr", "level.preview.png", "level.glb"]);
        for o in &report.outputs {
            let bytes = fs::read(set.folder().join(&o.path)).unwrap();
            assert_eq!((o.bytes, &o.blake3), (bytes.len() as u64, &blake3::hash(&bytes).to_hex().to_string()));
        }
        let read: Report = serde_json::from_slice(&fs::read(set.report()).unwrap()).unwrap();
        assert_eq!(read, report);
        assert!(is_output(&set.glb()));
        assert!(!is_output(&dir.path().join("level.glb")));
        fs::rename(set.glb(), set.folder().join("own.glb")).unwrap();
        assert!(!is_output(&set.folder().join("own.glb")));
        fs::write(set.report(), b"{}").unwrap();
        assert!(!is_output(&set.glb()));
    }

    #[test]
    fn pages_of_an_earlier_bake_go_and_strangers_stay() {
        let dir = tempfile::tempdir().unwrap();
        let set = OutputSet::new(&dir.path().join("level.glb"), None, None).unwrap();
        write(&set, 3);
        for stranger in
            ["level.lightmap.x.exr", "level2.lightmap.exr", "level.lightmap.2.exr.bak", "level.lightmaps.exr"]
        {
            fs::write(set.folder().join(stranger), b"x").unwrap();
        }
        write(&set, 1);
        let expected = [
            "level.bake.json",
            "level.bound.exr",
            "level.glb",
            "level.lightmap.2.exr.bak",
            "level.lightmap.exr",
            "level.lightmap.x.exr",
            "level.lightmaps.exr",
            "level.preview.png",
            "level2.lightmap.exr",
        ];
        assert_eq!(names(set.folder()), expected);
    }

    #[test]
    fn a_failure_at_any_file_keeps_every_old_one() {
        let dir = tempfile::tempdir().unwrap();
        let set = OutputSet::new(&dir.path().join("level.glb"), None, None).unwrap();
        write(&set, 2);
        let all = || -> Vec<_> {
            names(set.folder()).into_iter().map(|n| (fs::read(set.folder().join(&n)).unwrap(), n)).collect()
        };
        let before = all();
        let map = Lightmap::new(1, 1, vec![Vec3::ZERO], vec![1.0]).unwrap();
        let files = Images {
            lightmaps: &[map],
            bounds: &[],
            depth: Depth::Float,
            effort: Effort::Small,
            key: "k",
            preview_png: Some(b"new png"),
        };
        let write_until = |last: usize| {
            let count = AtomicUsize::new(0);
            let fill = |content: &Content, file: &mut fs::File| {
                let before = count.fetch_add(1, Ordering::Relaxed);
                content.write(file)?;
                // Half of it is on the disk.
                file.set_len(file.metadata()?.len() / 2)?;
                if before >= last { Err(io::Error::other("disk full")) } else { Ok(()) }
            };
            let images = set.stage_by(&files, &Silent, &fill)?;
            set.write_by(images, b"new", &mut Report::new(SceneInfo::default()), &Silent, &fill)
        };
        for last in 0..4 {
            let error = write_until(last).unwrap_err().to_string();
            assert!(error.contains("disk full") && all() == before, "after {last} files: {error}");
        }
        // A folder in the place of the last file is seen before the first file is replaced, too.
        fs::remove_file(set.report()).unwrap();
        fs::create_dir(set.report()).unwrap();
        let write = |report: &mut Report| set.write(set.stage(&files, &Silent)?, b"new", report, &Silent);
        let error = write(&mut Report::new(SceneInfo::default())).unwrap_err().to_string();
        assert!(error.contains("level.bake.json"), "{error}");
        fs::remove_dir(set.report()).unwrap();
        let kept = before.into_iter().filter(|(_, name)| name != "level.bake.json");
        assert!(all().into_iter().eq(kept));
        write_until(4).unwrap();
        assert_eq!(fs::read(set.glb()).unwrap(), b"n");
    }

    #[test]
    fn a_folder_in_the_place_of_a_file_is_named_beforehand() {
        let dir = tempfile::tempdir().unwrap();
        let set = OutputSet::new(&dir.path().join("level.glb"), None, None).unwrap();
        set.check_names().unwrap();
        write(&set, 2);
        set.check_names().unwrap();
        for name in ["level.glb", "level.bake.json", "level.preview.png", "level.lightmap.7.exr", "level.bound.exr"] {
            let path = set.folder().join(name);
            drop(fs::remove_file(&path));
            fs::create_dir(&path).unwrap();
            let error = set.check_names().unwrap_err().to_string();
            assert!(error.contains(name) && error.contains("--out"), "{error}");
            fs::remove_dir(&path).unwrap();
        }
        fs::create_dir(set.folder().join("level.lightmaps.exr")).unwrap();
        set.check_names().unwrap();
    }

    #[test]
    fn a_bake_without_a_preview_leaves_no_old_one() {
        let dir = tempfile::tempdir().unwrap();
        let set = OutputSet::new(&dir.path().join("level.glb"), None, None).unwrap();
        write(&set, 1);
        let files = Images {
            lightmaps: &[],
            bounds: &[],
            depth: Depth::Float,
            effort: Effort::Small,
            key: "k",
            preview_png: None,
        };
        let staged = set.stage(&files, &Silent).unwrap();
        set.write(staged, b"new", &mut Report::new(SceneInfo::default()), &Silent).unwrap();
        assert_eq!(names(set.folder()), ["level.bake.json", "level.glb"]);
    }

    #[test]
    fn a_report_that_cannot_be_written_keeps_every_old_file() {
        let dir = tempfile::tempdir().unwrap();
        let set = OutputSet::new(&dir.path().join("level.glb"), None, None).unwrap();
        write(&set, 1);
        let before: Vec<_> = names(set.folder()).iter().map(|n| fs::read(set.folder().join(n)).unwrap()).collect();
        let map = Lightmap::new(1, 1, vec![Vec3::ZERO], vec![1.0]).unwrap();
        let files = Images {
            lightmaps: &[map],
            bounds: &[],
            depth: Depth::Float,
            effort: Effort::Small,
            key: "k",
            preview_png: None,
        };
        let mut report = Report::new(SceneInfo::default());
        report.quality.insert("rate".into(), f64::NAN);
        let staged = set.stage(&files, &Silent).unwrap();
        assert!(set.write(staged, b"new", &mut report, &Silent).is_err());
        let after: Vec<_> = names(set.folder()).iter().map(|n| fs::read(set.folder().join(n)).unwrap()).collect();
        assert_eq!(before, after);
    }
}
