//! The end of a bake, and of a draft of it: the report, the scene with its lightmap, the files.

use std::collections::BTreeMap;
use std::time::Instant;

use luxel_export::{Depth, Effort, Images, Original};

use super::journal::Journal;
use super::tracer::Tracer;
use super::{Baked, Baking, Lit, Request, export, input, report};
use crate::Error;
use crate::store::Key;

/// What the files of a bake are made of beside its light; a draft of it has the same.
pub struct Outgoing<'a> {
    pub request: &'a Request,
    pub tracer: &'a Tracer<'a>,
    pub original: &'a Original,
    pub inputs: &'a input::Inputs,
    pub key: Key,
    /// Weights of the light groups, where they are not the scene's own.
    pub weights: BTreeMap<String, f64>,
    pub start: Instant,
}

impl Outgoing<'_> {
    /// Replaces the files of the last bake. `notes` are what the store had to say.
    pub fn write(
        &self,
        baking: &Baking,
        lit: &Lit,
        picture: Option<&[u8]>,
        effort: Effort,
        (notes, seconds): (Vec<String>, f64),
        mut journal: Journal,
    ) -> Result<Baked, Error> {
        let (scene, request, progress) = (self.tracer.geometry.scene, self.request, journal.progress);
        let mut report = report::start(scene, self.inputs, baking.plan, &request.settings, &baking.keys.parts);
        report.mix = self.weights.clone();
        let key = blake3::Hash::from(self.key).to_hex();
        let (lightmaps, bounds) = (&lit.lightmaps[..], &lit.bounds[..]);
        let images = Images { lightmaps, bounds, depth: Depth::Float, effort, key: &key, preview_png: picture };
        let made =
            export::encode(request, (self.original, scene), baking.plan, (lit, &images), &mut report, &mut journal)?;
        report::fill(&mut report, scene, baking, lit, notes, journal, seconds);
        report.draft = effort == Effort::Fast;
        let files = export::write(&request.outputs, made, &mut report, progress)?;
        let seconds = self.start.elapsed().as_secs_f64();
        Ok(Baked { report, files, inputs: self.inputs.read.clone(), seconds })
    }
}
