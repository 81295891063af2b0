//! The end of a bake, and of a draft of it: the report, the scene with its lightmap, the files.

use std::collections::BTreeMap;
use std::time::Instant;

use luxel_export::{BoundMap, Depth, Effort, Files, Lightmap, Original, Report};
use luxel_scene::Progress;

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
    /// The report, but for the files, and the scene with its lightmap. `notes` are what the store had to say.
    pub fn encoded(
        &self,
        baking: &Baking,
        lit: &Lit,
        effort: Effort,
        (notes, seconds): (Vec<String>, f64),
        mut journal: Journal,
    ) -> Result<(Report, Vec<u8>), Error> {
        let (scene, request) = (self.tracer.geometry.scene, self.request);
        let mut report = report::start(scene, self.inputs, baking.plan, &request.settings, &baking.keys.parts);
        report.mix = self.weights.clone();
        let glb = export::glb(request, (self.original, scene), baking.plan, lit, effort, &mut report, &mut journal)?;
        report::fill(&mut report, scene, baking, lit, notes, journal, seconds);
        Ok((report, glb))
    }

    /// Replaces the files of the last bake.
    pub fn written(
        &self,
        mut report: Report,
        (lightmaps, bounds): (&[Lightmap], &[BoundMap]),
        picture: Option<&[u8]>,
        glb: &[u8],
        effort: Effort,
        progress: &dyn Progress,
    ) -> Result<Baked, Error> {
        let key = blake3::Hash::from(self.key).to_hex();
        let files = Files { lightmaps, bounds, depth: Depth::Float, effort, key: &key, preview_png: picture, glb };
        let files = export::write(&self.request.outputs, &files, &mut report, progress)?;
        let seconds = self.start.elapsed().as_secs_f64();
        Ok(Baked { report, files, inputs: self.inputs.read.clone(), seconds })
    }
}
