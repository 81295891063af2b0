//! Lightmaps as they are sent, each decoded once, whoever asks and however many do.
//!
//! They are known by the digest of their file, so what is kept cannot be that of another bake. Everybody who sends one
//! holds the same bytes; nobody else keeps them but for [`KEPT`] bytes of the last ones, which go as well when nobody
//! has asked for a while ([`Decoded::forget`]).

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::io::ErrorKind;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};

use super::http::Refusal;
use super::outputs::File;
use super::texels;

/// What is kept for those who ask later [bytes]: one page of 4096 texels squared, or many smaller ones.
const KEPT: usize = 160 << 20;

/// Texels as a page takes them.
pub type Texels = Arc<Vec<u8>>;

#[derive(Debug, Default)]
pub struct Decoded {
    state: Mutex<State>,
    /// Somebody has ended decoding.
    ended: Condvar,
    /// Decoding an atlas takes many times its memory, and all cores: one at a time.
    turn: Mutex<()>,
}

#[derive(Debug, Default)]
struct State {
    /// By the digest of the file.
    known: BTreeMap<String, Weak<Vec<u8>>>,
    busy: BTreeSet<String>,
    /// The last ones, the newest behind.
    kept: VecDeque<Texels>,
    /// How often a file was decoded.
    count: usize,
}

/// A file that one thread decodes, whether or not that ends well.
struct Busy<'a>(&'a Decoded, &'a str);

impl Drop for Busy<'_> {
    fn drop(&mut self) {
        self.0.lock().busy.remove(self.1);
        self.0.ended.notify_all();
    }
}

impl Decoded {
    /// The texels of a lightmap; waits for whoever decodes it already.
    pub fn of(&self, file: &File) -> Result<Texels, Refusal> {
        let mut state = self.lock();
        loop {
            if let Some(texels) = state.known.get(&file.hash).and_then(Weak::upgrade) {
                return Ok(texels);
            }
            if state.busy.insert(file.hash.clone()) {
                break;
            }
            state = self.ended.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        drop(state);
        let _busy = Busy(self, &file.hash);
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        let texels = Arc::new(decode(file)?);
        self.lock().keep(&file.hash, &texels);
        Ok(texels)
    }

    /// Keeps nothing that nobody is sending.
    pub fn forget(&self) {
        let mut state = self.lock();
        state.kept.clear();
        state.known.retain(|_, texels| texels.strong_count() > 0);
    }

    /// Every change is whole before anything can panic.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn keep(&mut self, hash: &str, texels: &Texels) {
        self.count += 1;
        self.kept.push_back(texels.clone());
        // The last one in any case: it was decoded for somebody who is about to ask.
        while self.kept.len() > 1 && self.kept.iter().map(|t| t.len()).sum::<usize>() > KEPT {
            self.kept.pop_front();
        }
        self.known.retain(|_, texels| texels.strong_count() > 0);
        self.known.insert(hash.to_owned(), Arc::downgrade(texels));
    }
}

fn decode(file: &File) -> Result<Vec<u8>, Refusal> {
    let refusal = |error: std::io::Error| match error.kind() {
        ErrorKind::FileTooLarge => Refusal::Large,
        _ => Refusal::Overtaken,
    };
    let exr = file.read(texels::MAX_BYTES).map_err(refusal)?;
    // Whether these are the right bytes takes as long to find out as a good part of decoding them.
    let (is_right, texels) = std::thread::scope(|scope| {
        // Not in the pool of bakes, one of which may be at work.
        let other = std::thread::Builder::new().name("luxel preview".into()).spawn_scoped(scope, || file.is(&exr));
        let texels = texels::decode(&exr);
        (other.map_or_else(|_| file.is(&exr), |other| other.join().unwrap_or(false)), texels)
    });
    if !is_right {
        return Err(Refusal::Overtaken);
    }
    texels.map_err(|fault| match fault {
        texels::Fault::Large => Refusal::Large,
        texels::Fault::Broken => Refusal::Broken,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::outputs::Outputs;
    use glam::Vec3;
    use luxel_export::{Depth, Effort, Images, Lightmap, OutputSet, Report, report::SceneInfo};
    use luxel_scene::Silent;
    use std::path::Path;

    fn outputs(folder: &Path, light: f32) -> Outputs {
        let map = Lightmap::new(64, 64, vec![Vec3::splat(light); 64 * 64], vec![1.0; 64 * 64]).unwrap();
        let set = OutputSet::new(&folder.join("a.gltf"), None, None).unwrap();
        std::fs::create_dir_all(set.folder()).unwrap();
        let (depth, effort) = (Depth::Half, Effort::Small);
        let images = Images { lightmaps: &[map], bounds: &[], depth, effort, key: "k", preview_png: None };
        let images = set.stage(&images, &Silent).unwrap();
        set.write(images, b"no glb", &mut Report::new(SceneInfo::default()), &Silent).unwrap();
        Outputs::read(&set.report()).unwrap()
    }

    #[test]
    fn many_readers_share_what_is_decoded_once_and_nothing_is_kept_for_nobody() {
        let folder = tempfile::tempdir().unwrap();
        let (first, decoded) = (outputs(folder.path(), 1.0), Decoded::default());
        let file = first.files.iter().find(|f| f.content_type() == "image/x-exr").unwrap();
        let readers: Vec<Texels> = std::thread::scope(|scope| {
            let readers: Vec<_> = (0..30).map(|_| scope.spawn(|| decoded.of(file).unwrap())).collect();
            readers.into_iter().map(|r| r.join().unwrap()).collect()
        });
        assert!(readers.iter().all(|r| Arc::ptr_eq(r, &readers[0])));
        assert_eq!((decoded.lock().count, readers[0].len()), (1, 16 + 8 * 64 * 64));
        let weak = Arc::downgrade(&readers[0]);
        drop(readers);
        assert!(weak.upgrade().is_some(), "somebody may ask soon");
        decoded.forget();
        assert!(weak.upgrade().is_none() && decoded.lock().known.is_empty());
        // Another light in the same place: the old one is told from it, and the new one is decoded.
        let second = outputs(folder.path(), 2.0);
        assert_eq!(decoded.of(file), Err(Refusal::Overtaken));
        assert!(decoded.of(&second.files[1]).is_ok() && decoded.lock().count == 2);
        assert!(decoded.lock().busy.is_empty());
    }
}
