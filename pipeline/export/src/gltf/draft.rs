//! The document under construction.
//!
//! New accessors and bufferViews get provisional indices past the end. When everything is known, they move into the
//! slots of old ones that nothing refers to any more, and only then to the end of the list: so no index of the input
//! ever changes its meaning, not even for extensions that luxel does not know, and outdated vertices leave the file.

use std::collections::BTreeSet;

use luxel_scene::Progress;
use luxel_scene::import::{Checked, Fault, buffers::MESHOPT};
use serde_json::{Value, json};

use super::{
    json::{self, Object, list, list_mut, objects_mut},
    original::{Blob, Original},
    references::{self, Each},
};

/// glTF's names for what a bufferView is used for.
#[derive(Clone, Copy)]
pub enum Target {
    Vertices,
    Indices,
    Other,
}

/// A copy of the original's JSON that grows.
pub struct Draft<'a> {
    pub root: Object,
    original: &'a Original,
    accessors: Vec<Value>,
    views: Vec<(Value, Vec<u8>)>,
}

impl<'a> Draft<'a> {
    pub fn new(original: &'a Original) -> Self {
        Self { root: original.root.clone(), original, accessors: Vec::new(), views: Vec::new() }
    }

    /// Adds a bufferView; returns its provisional index.
    pub fn add_view(&mut self, bytes: Vec<u8>, target: Target) -> usize {
        let mut view = json!({ "buffer": 0, "byteLength": bytes.len() });
        match target {
            Target::Vertices => view["target"] = 34962.into(),
            Target::Indices => view["target"] = 34963.into(),
            Target::Other => {}
        }
        self.views.push((view, bytes));
        self.original.views() + self.views.len() - 1
    }

    /// Adds a bufferView whose elements lie `stride` bytes apart.
    pub fn add_strided_view(&mut self, bytes: Vec<u8>, stride: usize) -> usize {
        let index = self.add_view(bytes, Target::Vertices);
        if let Some((view, _)) = self.views.last_mut() {
            view["byteStride"] = stride.into();
        }
        index
    }

    /// Adds an accessor; returns its provisional index.
    pub fn add_accessor(&mut self, accessor: Value) -> usize {
        self.accessors.push(accessor);
        list(&self.original.root, "accessors").len() + self.accessors.len() - 1
    }

    /// The finished .glb.
    pub fn finish(mut self, progress: &dyn Progress) -> Checked<Vec<u8>> {
        progress.check()?;
        let mut possible = references::possible(&self.root);
        // What nothing referred to before may be meant for somebody whom luxel does not know.
        let mut before = self.original.root.clone();
        let was_used = references::used(&mut before, references::accessors);
        let new = std::mem::take(&mut self.accessors);
        settle(&mut self.root, "accessors", references::accessors, new, &was_used, &possible)?;
        progress.check()?;
        let was_used = references::used(&mut before, references::views);
        possible.retain(|i| *i < self.original.views());
        let (json, new_blobs): (Vec<Value>, Vec<Vec<u8>>) = std::mem::take(&mut self.views).into_iter().unzip();
        let slots = settle(&mut self.root, "bufferViews", references::views, json, &was_used, &possible)?;
        let mut sources = (0..self.original.views()).map(|i| self.original.blob(i)).collect::<Checked<Vec<Blob>>>()?;
        for (slot, bytes) in slots.into_iter().zip(&new_blobs) {
            match sources.get_mut(slot) {
                Some(source) => *source = Blob::Bytes(bytes),
                None => sources.push(Blob::Bytes(bytes)),
            }
        }
        let bin = self.lay_out(&sources, progress)?;
        progress.check()?;
        let json = serde_json::to_vec(&self.root).map_err(|e| Fault::invalid("JSON", e.to_string()))?;
        super::glb_bytes(json, &bin, progress)
    }

    /// Puts all bufferViews into one buffer. Views that share bytes of a source buffer go on sharing them; bytes that
    /// no view names are left out.
    fn lay_out(&mut self, sources: &[Blob], progress: &dyn Progress) -> Checked<Vec<u8>> {
        let mut bin = Vec::new();
        let mut offsets = vec![0; sources.len()];
        let mut ranges: Vec<(usize, usize, usize, usize)> = Vec::new();
        for (i, source) in sources.iter().enumerate() {
            progress.check()?;
            match source {
                Blob::Range { buffer, range } => ranges.push((*buffer, range.start, range.end, i)),
                Blob::Bytes(bytes) => {
                    bin.resize(bin.len().next_multiple_of(4), 0);
                    offsets[i] = bin.len();
                    bin.extend_from_slice(bytes);
                }
            }
        }
        ranges.sort_unstable();
        // The run being copied: its buffer, its end there, and where the buffer's byte 0 would be in `bin`.
        let mut run: Option<(usize, usize, usize)> = None;
        for (buffer, start, end, i) in ranges {
            progress.check()?;
            let (copied, shift) = match run {
                Some((b, run_end, shift)) if b == buffer && start < run_end => (run_end, shift),
                _ => {
                    // Keeping the position within a word keeps every alignment that the input had.
                    bin.resize(bin.len().next_multiple_of(4) + start % 4, 0);
                    (start, bin.len().wrapping_sub(start))
                }
            };
            if end > copied {
                bin.extend_from_slice(&self.original.buffers.bytes(buffer)[copied..end]);
            }
            run = Some((buffer, end.max(copied), shift));
            offsets[i] = shift.wrapping_add(start);
        }
        if bin.is_empty() && !sources.is_empty() {
            // Views without a byte need a buffer all the same, and a buffer has at least one.
            bin.resize(4, 0);
        }
        self.describe_buffer(&offsets, bin.len());
        Ok(bin)
    }

    fn describe_buffer(&mut self, offsets: &[usize], length: usize) {
        for (view, offset) in objects_mut(&mut self.root, "bufferViews").zip(offsets) {
            view.insert("buffer".into(), 0.into());
            view.insert("byteOffset".into(), (*offset).into());
        }
        if length == 0 {
            self.root.shift_remove("buffers");
            return;
        }
        // The first buffer keeps its name and extras.
        let mut buffer = match list(&self.root, "buffers").first() {
            Some(Value::Object(first)) => first.clone(),
            _ => Object::new(),
        };
        buffer.shift_remove("uri");
        MESHOPT.iter().for_each(|n| json::remove_extension(&mut buffer, n));
        buffer.insert("byteLength".into(), length.into());
        self.root.insert("buffers".into(), Value::Array(vec![Value::Object(buffer)]));
    }
}

/// Gives the new items their final indices: first the slots that were in use before and are not any more, then the
/// end of the list. Returns the index of every new item.
fn settle(
    root: &mut Object,
    key: &str,
    each: Each,
    new: Vec<Value>,
    was_used: &BTreeSet<usize>,
    possible: &BTreeSet<usize>,
) -> Checked<Vec<usize>> {
    let old = list(root, key).len();
    let now = references::used(root, each);
    let mut free = was_used.iter().copied().filter(|i| *i < old && !now.contains(i) && !possible.contains(i));
    let mut end = old;
    let slots: Vec<usize> = (0..new.len()).map(|_| free.next().unwrap_or_else(|| post_increment(&mut end))).collect();
    put(root, key, each, new, &slots)?;
    Ok(slots)
}

/// Gives copies their final indices: the first copy of an item that nobody uses any more takes its slot, so that
/// whatever else points at the item (an animation, say) goes on doing so; the others go to the end. Slots in `taken`
/// are left alone.
pub fn settle_copies(
    root: &mut Object,
    key: &str,
    each: Each,
    copies: Vec<(Option<usize>, Value)>,
    mut taken: BTreeSet<usize>,
) -> Checked<()> {
    taken.extend(references::used(root, each));
    let mut end = list(root, key).len();
    let (origins, new): (Vec<Option<usize>>, Vec<Value>) = copies.into_iter().unzip();
    let own = |origin: Option<usize>| origin.filter(|o| taken.insert(*o));
    let own: Vec<Option<usize>> = origins.into_iter().map(own).collect();
    let slots: Vec<usize> = own.into_iter().map(|own| own.unwrap_or_else(|| post_increment(&mut end))).collect();
    put(root, key, each, new, &slots)
}

fn post_increment(end: &mut usize) -> usize {
    *end += 1;
    *end - 1
}

/// Puts item k, so far known by the provisional index `len + k`, into `slots[k]`, and follows it with all references.
fn put(root: &mut Object, key: &str, each: Each, new: Vec<Value>, slots: &[usize]) -> Checked<()> {
    if new.is_empty() {
        return Ok(());
    }
    follow(root, each, list(root, key).len(), slots);
    slots.iter().zip(new).try_for_each(|(slot, value)| put_item(root, key, *slot, value))
}

/// Points every reference to the provisional index `old + k` at `slots[k]`.
pub fn follow(root: &mut Object, each: Each, old: usize, slots: &[usize]) {
    each(root, &mut |reference| {
        let provisional = json::index(reference).and_then(|i| i.checked_sub(old));
        if let Some(slot) = provisional.and_then(|k| slots.get(k)) {
            *reference = (*slot).into();
        }
    });
}

/// Replaces an item, or adds it at the end.
pub fn put_item(root: &mut Object, key: &str, slot: usize, value: Value) -> Checked<()> {
    let items = list_mut(root, key)?;
    match items.get_mut(slot) {
        Some(item) => *item = value,
        None => items.push(value),
    }
    Ok(())
}
