//! The scenes of a watch: what each was found to be, what its outputs were made from, and what follows from that.
//!
//! Nothing here remembers that something "has to be done". Whether a scene is to be baked follows from three looks: as
//! it is now, as it was for the last good bake, and as it was when a bake failed. So no change can be lost, none is
//! baked twice, and what is changed back is current again.

use std::collections::{BTreeMap, BTreeSet};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use luxel_export::OutputSet;
use luxel_scene::InputFile;

use super::Options;
use super::batch::Hints;
use super::depend::{Digests, Look, read};
use super::event::{Event, Fault};
use super::item::{Failure, Item};
use super::place::{Place, leads_to};
use crate::content::{Content, sky};
use crate::discover::{self, Found, is_scene, is_searched};

/// All scenes.
pub struct Book {
    options: Options,
    items: BTreeMap<PathBuf, Item>,
    digests: Digests,
    /// The folders that searches enter, by their real paths.
    tree: BTreeSet<PathBuf>,
    /// Names of the named paths themselves, and where they are or would appear.
    roots: Vec<Place>,
    /// Everything whose removal, or that of a folder above it, matters.
    anchors: BTreeSet<PathBuf>,
    /// Folders that could not be searched, and why.
    closed: BTreeMap<PathBuf, String>,
    changes: u64,
}

impl Book {
    /// Nothing is looked at any more once the watch is `ending`.
    pub fn new(options: Options, ending: Arc<AtomicBool>) -> Self {
        Self {
            options,
            items: BTreeMap::new(),
            digests: Digests::until(ending),
            tree: BTreeSet::new(),
            roots: Vec::new(),
            anchors: BTreeSet::new(),
            closed: BTreeMap::new(),
            changes: 0,
        }
    }

    pub fn item(&self, scene: &Path) -> Option<&Item> {
        self.items.get(scene)
    }

    /// How many scenes there are.
    pub fn scenes(&self) -> usize {
        self.items.values().filter(|i| i.here).count()
    }

    /// Scenes that cannot be baked as they are now.
    pub fn failed(&self) -> Vec<PathBuf> {
        self.items.iter().filter(|(_, i)| i.is_broken()).map(|(s, _)| s.clone()).collect()
    }

    /// Scenes whose outputs are drafts.
    pub fn drafts(&self) -> Vec<PathBuf> {
        let unbaked = self.items.iter().filter(|(_, i)| i.here && i.baked.is_none());
        unbaked.filter(|(_, i)| i.kept() == Some(true)).map(|(s, _)| s.clone()).collect()
    }

    /// Whether a scene's outputs are a draft; none where it has no outputs.
    pub fn kept(&self, scene: &Path) -> Option<bool> {
        self.items.get(scene)?.kept()
    }

    /// All scenes, each with the report of an earlier bake where there is one.
    pub fn reports(&self) -> Vec<(PathBuf, Option<PathBuf>)> {
        let report = |i: &Item| i.look.outputs.as_ref().ok().map(OutputSet::report).filter(|report| report.is_file());
        self.items.iter().filter(|(_, i)| i.here).map(|(s, i)| (s.clone(), report(i))).collect()
    }

    /// The scene to be baked next: the one that has changed last, since somebody waits for it.
    pub fn next(&self) -> Option<&Path> {
        let wanted = self.items.iter().filter(|(_, i)| i.is_wanted());
        // Of equals, the first in order.
        wanted.rev().max_by_key(|(_, i)| i.changed).map(|(scene, _)| scene.as_path())
    }

    /// Folders to watch, by their real paths.
    pub fn folders(&self) -> BTreeSet<PathBuf> {
        let own = self.items.values().flat_map(|i| &i.folders);
        own.chain(&self.tree).chain(self.roots.iter().map(|p| &p.folder)).cloned().collect()
    }

    /// Whether an event at this path can matter: cheap, since there are many of which none does.
    pub fn concerns(&self, path: &Path) -> bool {
        leads_to(path, &self.anchors) || self.may_be_new(path) || self.may_be_missed(path).next().is_some()
    }

    /// Scenes that depend on the file, and the path by which each knows it.
    pub fn depending(&self, path: &Path) -> Vec<(PathBuf, PathBuf)> {
        let known = self.items.iter().filter_map(|(s, i)| Some((s.clone(), i.keys.get(path)?.clone())));
        known.collect()
    }

    /// Something that a search would find, or a folder that it would enter.
    fn may_be_new(&self, path: &Path) -> bool {
        let is_found = |path: &Path| is_scene(path) || path.is_dir() && is_searched(path, None);
        path.parent().is_some_and(|folder| self.tree.contains(folder)) && is_found(path)
    }

    /// Scenes that miss something that may be this file under another spelling of its name.
    fn may_be_missed<'a>(&'a self, path: &'a Path) -> impl Iterator<Item = &'a PathBuf> {
        let here = move |i: &Item| path.parent().is_some_and(|p| i.folders.contains(p)) && i.look.lacks();
        self.items.iter().filter(move |(_, i)| here(i)).map(|(scene, _)| scene)
    }

    /// Looks at whatever hinted paths concern: tells what has changed.
    pub fn attend(&mut self, hints: &Hints, tell: &mut dyn FnMut(Event)) {
        let mut touched: BTreeMap<PathBuf, BTreeSet<PathBuf>> = BTreeMap::new();
        let mut whole = hints.everywhere;
        let again: Vec<(PathBuf, PathBuf)> = hints.again.iter().flat_map(|path| self.depending(path)).collect();
        for (scene, file) in again {
            self.digests.forget(&file);
            touched.entry(scene).or_default();
        }
        for path in hints.paths.keys() {
            let depending = self.depending(path);
            // Of a scene that was away only a search finds out that it is back.
            let is_here = |scene: &PathBuf| self.items.get(scene).is_some_and(|i| i.here);
            let known = !depending.is_empty() && depending.iter().all(|(scene, _)| is_here(scene));
            for (scene, file) in depending {
                self.digests.forget(&file);
                touched.entry(scene).or_default().insert(file);
            }
            let missed: Vec<PathBuf> = self.may_be_missed(path).cloned().collect();
            for scene in missed {
                touched.entry(scene).or_default();
            }
            whole |= !(known && path.is_file()) && (leads_to(path, &self.anchors) || self.may_be_new(path));
        }
        let known: BTreeSet<PathBuf> = self.items.iter().filter(|(_, i)| i.here).map(|(s, _)| s.clone()).collect();
        if whole {
            self.survey(true, tell);
        }
        let scenes: Vec<PathBuf> =
            if whole { self.items.keys().cloned().collect() } else { touched.keys().cloned().collect() };
        for scene in scenes {
            let is_news = self.look(&scene, tell);
            if self.is_ending() {
                return;
            }
            let files = touched.remove(&scene).unwrap_or_default();
            // Of one that has just been found it was said that it is there.
            if !is_news
                && !files.is_empty()
                && known.contains(&scene)
                && let Some(item) = self.items.get_mut(&scene).filter(|i| i.here)
            {
                // What stood in its way may have gone: a full disk, a folder that was closed.
                item.failed.take_if(|f| !f.is_lasting);
                tell(Event::Unchanged { scene, files: files.into_iter().collect() });
            }
        }
        self.index();
    }

    /// Searches for scenes. What is new is told if `news` says so.
    pub fn survey(&mut self, news: bool, tell: &mut dyn FnMut(Event)) {
        let out = self.options.out.as_ref().and_then(|o| o.canonicalize().ok());
        (self.tree, self.roots) = Default::default();
        let mut found = Findings::default();
        let mut closed = BTreeMap::new();
        for (path, is_folder) in &self.options.paths {
            self.roots.extend(Place::all(path));
            if !*is_folder {
                if path.exists() {
                    found.add(Found { scene: path.clone(), root: None });
                }
                continue;
            }
            let below = discover::below(path, out.as_deref());
            self.tree.extend(below.folders.iter().filter_map(|f| f.canonicalize().ok()));
            for scene in below.scenes {
                found.add(Found { scene, root: Some(path.clone()) });
            }
            // A named folder that is not there, or is a file now, holds nothing; any other error says nothing of what is
            // there.
            let is_gone = |e: &std::io::Error| matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory);
            for (folder, error) in below.closed.into_iter().filter(|(_, e)| !is_gone(e)) {
                // What was known of it stays.
                let is_known = |i: &&Item| i.here && i.found.root.as_ref() == Some(path);
                let known = self.items.values().filter(is_known).filter(|i| i.found.scene.starts_with(&folder));
                known.for_each(|i| found.add(i.found.clone()));
                let reason = format!("it cannot be searched for scenes: {error}");
                if self.closed.get(&folder) != Some(&reason) {
                    tell(Event::Unwatched { path: folder.clone(), reason: reason.clone() });
                }
                closed.insert(folder, reason);
            }
        }
        self.closed = closed;
        let mut found = found.scenes;
        self.leave_outputs_alone(&mut found);
        self.register(found, news, tell);
    }

    /// A bake writes its .glb before the report by which a search knows it: what a known scene writes is none.
    fn leave_outputs_alone(&self, found: &mut BTreeMap<PathBuf, Found>) {
        let outputs: BTreeSet<PathBuf> = self.items.values().filter_map(|i| i.target.clone()).collect();
        found.retain(|scene, f| f.root.is_none() || Place::of(scene).is_none_or(|p| !outputs.contains(&p.key)));
    }

    fn register(&mut self, found: BTreeMap<PathBuf, Found>, news: bool, tell: &mut dyn FnMut(Event)) {
        for (scene, item) in &mut self.items {
            if item.here && !found.contains_key(scene) {
                item.here = false;
                tell(Event::Removed { scene: scene.clone() });
            }
        }
        // Of one that was never baked there is nothing to know when it comes back.
        self.items.retain(|_, item| item.here || item.baked.is_some());
        for (scene, found) in found {
            let known = self.items.get_mut(&scene);
            let is_new = known.as_ref().is_none_or(|i| !i.here);
            match known {
                Some(item) => (item.here, item.found) = (true, found),
                None => drop(self.items.insert(scene.clone(), Item::new(found))),
            }
            if is_new {
                self.look(&scene, &mut |_| {});
            }
            if is_new && news {
                tell(Event::Found { scene });
            } else if is_new && let Some(item) = self.items.get_mut(&scene) {
                // Nobody waits for one of these more than for another.
                item.changed = 0;
            }
        }
        self.index();
    }

    /// Looks at a scene anew; tells and returns whether it, or what lies at its outputs, differs from before.
    pub fn look(&mut self, scene: &Path, tell: &mut dyn FnMut(Event)) -> bool {
        let Some(look) = self.glance(scene) else { return false };
        let Some(item) = self.items.get_mut(scene) else { return false };
        item.find(&look, &self.options);
        item.target = look.outputs.as_ref().ok().and_then(|o| Some(Place::of(&o.glb())?.key));
        let before = std::mem::replace(&mut item.look, look);
        let differs = before != item.look;
        if differs && item.here {
            tell_change(scene, &before, &item.look, tell);
        }
        // Who takes a scene away, and brings it back as it was, may have taken its outputs along.
        let lost = item.lose();
        let is_news = differs || !lost.is_empty();
        if is_news && item.here {
            self.changes += 1;
            item.changed = self.changes;
            let is_mended = item.failed.take_if(|f| f.look != item.look).is_some();
            if is_mended && item.baked.as_ref() == Some(&item.look) {
                tell(Event::Current { scene: scene.into(), outputs: item.outputs.clone() });
            }
        }
        if !lost.is_empty() {
            tell(Event::Lost { scene: scene.into(), files: lost });
        }
        is_news
    }

    /// What is found from now on is not to be believed.
    fn is_ending(&self) -> bool {
        self.digests.ending.load(Ordering::Relaxed)
    }

    /// A scene as it is now, of which nothing is kept; none of one that is not known, or where the watch ends meanwhile.
    pub fn glance(&mut self, scene: &Path) -> Option<Look> {
        let outputs = self.place(scene)?;
        let item = self.items.get(scene)?;
        let (settings, mut files) = read(scene, &self.options.choices);
        files.extend(item.read.iter().cloned());
        files.extend(settings.as_ref().ok().and_then(sky));
        let files = files.into_iter().map(|f| (self.digests.of(&f), f)).map(|(content, f)| (f, content)).collect();
        (!self.is_ending()).then_some(Look { files, settings, outputs })
    }

    /// A scene as it is now, after something happened at these of its files.
    pub fn glance_after(&mut self, scene: &Path, files: &[PathBuf]) -> Option<Look> {
        files.iter().for_each(|file| self.digests.forget(file));
        self.glance(scene)
    }

    /// One of these files has surely another content than when it was looked at last.
    pub fn are_others(&self, files: &[PathBuf]) -> bool {
        files.iter().any(|file| self.digests.is_of_other_length(file))
    }

    /// Where a scene's outputs go, if there is such a place and no other scene has it.
    fn place(&self, scene: &Path) -> Option<Result<OutputSet, Fault>> {
        let item = self.items.get(scene)?;
        let set = OutputSet::new(scene, self.options.out.as_deref(), item.found.root.as_deref());
        let set = match set {
            Ok(set) => set,
            Err(error) => return Some(Err(Fault::new(&error))),
        };
        let target = Place::of(&set.glb()).map(|place| place.key);
        let same = |i: &Item| i.here && i.target.is_some() && i.target == target;
        let other = self.items.iter().find(|(s, i)| s.as_path() < scene && same(i));
        Some(match other {
            Some((other, _)) => {
                let glb = set.glb();
                let (other, glb) = (other.display(), glb.display());
                let error = format!("{other} writes {glb} already: watch them with different --out");
                Err(Fault { error, causes: Vec::new() })
            }
            None => Ok(set),
        })
    }

    /// What events may speak of.
    fn index(&mut self) {
        let items = self.items.values();
        // Folders of outputs are not listened at, but who removes one is heard from above.
        let own = items.flat_map(|i| i.keys.keys().chain(&i.target));
        let keys = own.chain(&self.tree).chain(self.roots.iter().map(|p| &p.key));
        self.anchors = keys.cloned().collect();
        let named: BTreeSet<&Path> =
            self.items.values().flat_map(|i| i.look.files.keys()).map(PathBuf::as_path).collect();
        self.digests.retain(|path| named.contains(path));
    }

    /// A bake of `look` has ended well, having read `inputs`. The scene is to be looked at again after that: hints of
    /// what has changed meanwhile may have come and gone.
    pub fn succeeded(&mut self, scene: &Path, look: &Look, inputs: &[InputFile], outputs: Vec<PathBuf>) {
        let Some(item) = self.items.get_mut(scene) else { return };
        item.read = inputs.iter().map(|i| i.path.clone()).collect();
        item.outputs = outputs;
        item.failed = None;
        let Some(now) = self.glance(scene) else { return };
        let Some(item) = self.items.get_mut(scene) else { return };
        // What it really read counts, which may be newer than what the look saw that began it.
        let read = |path: &PathBuf| inputs.iter().find(|i| i.path == *path).map(|i| Content::Digest(i.digest));
        let files = now
            .files
            .iter()
            .map(|(path, content)| (path.clone(), read(path).or(look.files.get(path).copied()).unwrap_or(*content)));
        let baked = Look { files: files.collect(), ..look.clone() };
        if item.look == *look {
            item.look = baked.clone();
        } else {
            // What was seen to change during the bake has been told, and its hints are used up.
            for (path, content) in &baked.files {
                item.look.files.entry(path.clone()).or_insert(*content);
            }
        }
        item.find(&baked, &self.options);
        item.baked = Some(baked);
        self.index();
    }

    /// A draft has taken the place of a scene's outputs, so they are those of no bake, even if its files change back.
    pub fn drafted(&mut self, scene: &Path) {
        if let Some(item) = self.items.get_mut(scene) {
            item.baked = None;
        }
    }

    /// Nothing has been baked for a scene by this watch, so its outputs may be those of an earlier run.
    pub fn is_fresh(&self, scene: &Path) -> bool {
        self.items.get(scene).is_some_and(|item| item.baked.is_none())
    }

    /// A scene cannot be baked as `look` saw it; if that does not follow from the look alone, it is tried again when
    /// something happens to its files.
    pub fn failed_as(&mut self, scene: &Path, look: Look, fault: Fault, is_lasting: bool) {
        if let Some(item) = self.items.get_mut(scene) {
            item.failed = Some(Failure { look, fault, is_lasting });
        }
    }

    /// Why a scene cannot be baked as it is now.
    pub fn fault(&self, scene: &Path) -> Option<&Fault> {
        self.items.get(scene).filter(|i| i.is_broken())?.failed.as_ref().map(|f| &f.fault)
    }
}

/// What a search has found: no scene twice, by whatever names it is reached. The first one that was named counts.
#[derive(Default)]
struct Findings {
    scenes: BTreeMap<PathBuf, Found>,
    keys: BTreeSet<PathBuf>,
}

impl Findings {
    fn add(&mut self, found: Found) {
        let key = Place::of(&found.scene).map_or_else(|| found.scene.clone(), |place| place.key);
        if self.keys.insert(key) {
            self.scenes.insert(found.scene.clone(), found);
        }
    }
}

/// Tells what of a scene differs between two looks.
fn tell_change(scene: &Path, before: &Look, now: &Look, tell: &mut dyn FnMut(Event)) {
    let files = before.differences(now);
    if !files.is_empty() || before.settings != now.settings {
        tell(Event::Changed { scene: scene.into(), files });
    }
    // Where there is no place for its outputs, that is told as the fault which it is.
    if let (Ok(old), Ok(new)) = (&before.outputs, &now.outputs)
        && old != new
    {
        tell(Event::Moved { scene: scene.into(), glb: new.glb() });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{Layer, Origin};

    #[test]
    fn a_scene_that_was_never_baked_is_forgotten_when_it_goes() {
        let folder = tempfile::tempdir().unwrap();
        let flags = Layer::new(Origin::CommandLine);
        let choices = super::super::Choices { config: None, flags };
        let paths = vec![(folder.path().to_path_buf(), true)];
        let options = Options { paths, out: None, choices, worker: None, store: Default::default() };
        let mut book = Book::new(options, Arc::default());
        let [a, b] = ["a.glb", "b.glb"].map(|name| folder.path().join(name));
        [&a, &b].iter().for_each(|path| std::fs::write(path, "x").unwrap());
        book.survey(false, &mut |_| {});
        let look = book.item(&a).unwrap().look.clone();
        book.succeeded(&a, &look, &[], Vec::new());
        [&a, &b].iter().for_each(|path| std::fs::remove_file(path).unwrap());
        let mut gone = 0;
        book.survey(true, &mut |event| gone += usize::from(matches!(event, Event::Removed { .. })));
        assert_eq!((gone, book.scenes()), (2, 0));
        assert!(book.item(&a).is_some() && book.item(&b).is_none());
    }
}
