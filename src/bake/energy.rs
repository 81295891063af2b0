//! The energy ledger of a bake, stage by stage, as its report tells it: kept with the light at surfels, so that a bake
//! that reuses it reports the same figures.
//!
//! All entries are linear in the light, band by band: those of light groups are scaled by the groups' factors and added.
//! A group that came to rest after fewer bounces than another stays where it was.

use glam::DVec3;
use luxel_atlas::{Atlas, Texel};
use luxel_export::report::{EnergyStage, Warning};
use luxel_scene::Scene;
use luxel_transport::{
    Rgb,
    energy::{Balance, Gone},
    gather::surfel_index::SurfelIndex,
    geometry::Geometry,
    ledger::{Stage as Sweep, flux},
    surfel::{Solution, Surfels},
};
use serde::{Deserialize, Serialize};

use super::light::Parts;
use super::receivers::Side;

/// Largest share of the emitted light that may be missing or too much.
pub const LIMIT: f64 = 0.01;

/// Fluxes by which later stages are booked [lm].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Flows {
    /// What surfels sent, and the part that left the scene or came to no surfel.
    sent: [f64; 3],
    escaped: [f64; 3],
    /// Arrived at the surfels that texels lie on, and the part that they absorb.
    received: [f64; 3],
    kept: [f64; 3],
    /// The part of what is received where texels' own points are not free, so that they hold the light of others.
    hidden: [f64; 3],
}

impl Flows {
    /// Notes what arrives where texels are. Which surfaces have any is no matter of the light at surfels, so this is done
    /// anew for every gather. `area` is scene units squared over those of the frame.
    pub fn receive(
        &mut self,
        geometry: &Geometry,
        (surfels, solution): (&Surfels, &Solution),
        front: &Side,
        area: f64,
    ) {
        let comparable = comparable(geometry.scene);
        let here = |i: usize| {
            let surfel = &surfels.list[i];
            !surfel.back() && comparable[geometry.triangles[surfel.triangle as usize].instance as usize]
        };
        let light = |i: usize| if here(i) { solution.direct[i] + solution.indirect[i] } else { Rgb::ZERO };
        self.received = (flux(surfels, light) * area).to_array();
        self.kept = (flux(surfels, |i| (Rgb::ONE - surfels.list[i].albedo()) * light(i)) * area).to_array();
        let index = SurfelIndex::new(surfels);
        let mut hidden = DVec3::ZERO;
        for (i, point) in front.displaced() {
            let texel = front.texel(i);
            if comparable[front.chart(texel).instance as usize]
                && let Some(surfel) = index.find(point.position, point.normal)
            {
                hidden += solution.total(surfel).as_dvec3() * area_of(texel);
            }
        }
        self.hidden = hidden.to_array();
    }

    pub fn scaled(&self, factor: [f64; 3]) -> Self {
        let scaled = |flux| times(flux, factor);
        Self {
            sent: scaled(self.sent),
            escaped: scaled(self.escaped),
            received: scaled(self.received),
            kept: scaled(self.kept),
            hidden: scaled(self.hidden),
        }
    }

    pub fn joined(&self, other: &Self) -> Self {
        Self {
            sent: sum(self.sent, other.sent),
            escaped: sum(self.escaped, other.escaped),
            received: sum(self.received, other.received),
            kept: sum(self.kept, other.kept),
            hidden: sum(self.hidden, other.hidden),
        }
    }

    /// The share of reflected light that escapes.
    fn open(&self) -> [f64; 3] {
        [0, 1, 2].map(|b| if self.sent[b] > 0.0 { self.escaped[b] / self.sent[b] } else { 0.0 })
    }
}

/// The books while light is made.
#[derive(Clone, Debug, Default)]
pub struct Books {
    pub stages: Vec<EnergyStage>,
    pub flows: Flows,
    last: Balance,
}

impl Books {
    pub fn open(shot: Option<Balance>) -> Self {
        let mut books = Self { last: shot.unwrap_or_default(), ..Self::default() };
        if shot.is_some() {
            books.write("shoot".into());
        }
        books
    }

    /// Books the sweeps of a solution, the first of which brings the light of the sky; the first `bounces` of them are
    /// bounces, and another one is the solver's where it took steps of its own, else the tail. `gone` is what rays say of
    /// all light that is sent, where no refresh will book it: backs and veils take the same share of it from every sweep.
    pub fn propagate(
        &mut self,
        sweeps: &[Sweep],
        (bounces, is_stiff): (usize, bool),
        sky: Option<(DVec3, DVec3)>,
        gone: Option<&Gone>,
    ) {
        let part = |flux: fn(&Gone) -> DVec3| {
            gone.map_or(DVec3::ZERO, |gone| flux(gone) / gone.sent.max(DVec3::splat(f64::MIN_POSITIVE)))
        };
        let (taken, doubt) = (part(|gone| gone.absorbed), part(|gone| gone.error));
        let (mut error, mut sent) = (self.last.error, DVec3::ZERO);
        for (number, sweep) in sweeps.iter().enumerate() {
            if let Some(sky) = sky.filter(|_| number == 0) {
                self.last = self.last.with_sky(sky);
                error = self.last.error;
            }
            self.last = self.last.after(sweep);
            self.last.absorbed += taken * sweep.sent;
            sent += sweep.sent;
            // One estimate for all sweeps: what is wrong with it adds up.
            self.last.error = (error * error + (doubt * sent) * (doubt * sent)).map(f64::sqrt);
            self.flows.sent = sum(self.flows.sent, sweep.sent.to_array());
            self.flows.escaped = sum(self.flows.escaped, (sweep.escaped + taken * sweep.sent).to_array());
            self.write(match number < bounces {
                true => format!("bounce {}", number + 1),
                false if is_stiff => "stiff".into(),
                false => "tail".into(),
            });
        }
    }

    /// Books that indirect light was gathered anew at all surfels: what they absorb by it, `after` instead of `before`
    /// [lm], what of the light that was gathered is `gone` by rays instead of by sweeps, and what surfels reflect that was
    /// not gathered.
    pub fn refresh(&mut self, (before, after): (DVec3, DVec3), unsent: DVec3, gone: &Gone) {
        self.last.in_flight = unsent;
        self.last.absorbed += after - before + gone.absorbed;
        self.last.escaped += gone.escaped - DVec3::from(self.flows.escaped);
        self.last.error = (self.last.error * self.last.error + gone.error * gone.error).map(f64::sqrt);
        (self.flows.sent, self.flows.escaped) = (gone.sent.to_array(), (gone.escaped + gone.absorbed).to_array());
        self.write("refresh".into());
    }

    fn write(&mut self, name: String) {
        let Balance { emitted, sky, absorbed, escaped, in_flight, error } = self.last;
        let stage = EnergyStage {
            name,
            emitted: emitted.to_array(),
            from_sky: sky.to_array(),
            absorbed: absorbed.to_array(),
            escaped: escaped.to_array(),
            in_flight: in_flight.to_array(),
            error: error.to_array(),
            ..EnergyStage::default()
        };
        self.stages.push(stage.closed());
    }
}

/// Instances whose texels and surfels are of the same surface: what has holes, or lets light pass, has surfels of its
/// solid part alone.
fn comparable(scene: &Scene) -> Vec<bool> {
    let is = |instance: &luxel_scene::Instance| {
        let material = &scene.materials[scene.meshes[instance.mesh].material];
        instance.receives && instance.casts && !material.unlit && material.is_opaque()
    };
    scene.instances.iter().map(is).collect()
}

/// World area that a texel stands for [squared scene units].
fn area_of(texel: &Texel) -> f64 {
    f64::from(texel.footprint()) * f64::from(texel.footprint()) * f64::from(texel.coverage())
}

/// Flux through the texels of the surfaces that [`Flows::receive`] looks at [lm]. Of texels that something else partly
/// covers those count whose points are free, with all of their area: the midpoint rule. So the `displaced` ones do not, by
/// rising index.
pub fn through_texels(scene: &Scene, atlas: &Atlas, light: &Parts, displaced: &[usize]) -> [f64; 3] {
    let comparable = comparable(scene);
    let mut sum = DVec3::ZERO;
    for (i, texel) in atlas.texels.iter().enumerate() {
        if displaced.binary_search(&i).is_err() && comparable[atlas.chart(texel).instance as usize] {
            sum += light.total(i).as_dvec3() * area_of(texel);
        }
    }
    sum.to_array()
}

/// Books the lightmap: what texels hold in the place of what surfels have, who keep theirs where no texel is free. What is
/// absorbed, and what escapes after it
/// was reflected, changes in proportion; where some surfaces are not in the lightmap, those that are.
pub fn gathered(stages: &mut Vec<EnergyStage>, flows: &Flows, through: [f64; 3]) {
    let Some(last) = stages.last() else { return };
    let mut stage = EnergyStage { name: "gather".into(), ..last.clone() };
    let open = flows.open();
    for b in 0..3 {
        let kept = if flows.received[b] > 0.0 { flows.kept[b] / flows.received[b] } else { 0.0 };
        let change = through[b] + flows.hidden[b] - flows.received[b];
        stage.absorbed[b] += kept * change;
        stage.escaped[b] += (1.0 - kept) * open[b] * change;
    }
    stages.push(stage.closed());
}

/// The books of stronger lights, by band.
pub fn scaled(stages: &[EnergyStage], factor: [f64; 3]) -> Vec<EnergyStage> {
    let one = |stage: &EnergyStage| {
        let EnergyStage { name, emitted, from_sky, absorbed, escaped, in_flight, error, .. } = stage.clone();
        EnergyStage {
            name,
            emitted: times(emitted, factor),
            from_sky: times(from_sky, factor),
            absorbed: times(absorbed, factor),
            escaped: times(escaped, factor),
            in_flight: times(in_flight, factor),
            error: times(error, factor),
            ..EnergyStage::default()
        }
        .closed()
    };
    stages.iter().map(one).collect()
}

/// The books of two light groups together.
pub fn joined(a: &[EnergyStage], b: &[EnergyStage]) -> Vec<EnergyStage> {
    let mut ranks: Vec<(u64, &str)> = a.iter().chain(b).map(|s| (rank(&s.name), s.name.as_str())).collect();
    ranks.sort_unstable();
    ranks.dedup();
    let nothing = EnergyStage::default();
    // What a group did until then; before its first stage there was no light of it.
    let until = |stages: &[EnergyStage], wanted: u64| {
        stages.iter().rev().find(|s| rank(&s.name) <= wanted).cloned().unwrap_or_else(|| nothing.clone())
    };
    let one = |(wanted, name): (u64, &str)| {
        let (a, b) = (until(a, wanted), until(b, wanted));
        EnergyStage {
            name: name.into(),
            emitted: sum(a.emitted, b.emitted),
            from_sky: sum(a.from_sky, b.from_sky),
            absorbed: sum(a.absorbed, b.absorbed),
            escaped: sum(a.escaped, b.escaped),
            in_flight: sum(a.in_flight, b.in_flight),
            error: [0, 1, 2].map(|i| a.error[i].hypot(b.error[i])),
            ..EnergyStage::default()
        }
        .closed()
    };
    ranks.into_iter().map(one).collect()
}

/// The order of stages.
fn rank(name: &str) -> u64 {
    const LAST_BOUNCE: u64 = 1 << 32;
    let bounce = name.strip_prefix("bounce ").and_then(|number| number.parse::<u64>().ok());
    match (bounce, name) {
        (Some(number), _) => number.min(LAST_BOUNCE),
        (None, "shoot") => 0,
        (None, "stiff") => LAST_BOUNCE + 1,
        (None, "tail") => LAST_BOUNCE + 2,
        (None, "refresh") => LAST_BOUNCE + 3,
        (None, _) => LAST_BOUNCE + 4,
    }
}

/// The stages whose light is in the lightmap: a refresh gathers all indirect light anew, so what bounces lost or made is
/// seen after it, if it is still there.
fn lasting(stages: &[EnergyStage]) -> impl Iterator<Item = &EnergyStage> {
    let is_refreshed = stages.iter().any(|stage| stage.name == "refresh");
    let is_replaced = move |stage: &EnergyStage| is_refreshed && (1..rank("refresh")).contains(&rank(&stage.name));
    stages.iter().filter(move |stage| !is_replaced(stage))
}

/// The lasting stage after which most is amiss beyond twice the standard error of its estimates, and by what share.
pub fn worst(stages: &[EnergyStage]) -> Option<(&EnergyStage, f64)> {
    let sure = lasting(stages).map(|stage| (stage, (stage.share - 2.0 * stage.share_error).max(0.0)));
    sure.max_by(|(_, a), (_, b)| a.total_cmp(b))
}

/// The lasting stage of which least is known.
pub fn vaguest(stages: &[EnergyStage]) -> Option<&EnergyStage> {
    lasting(stages).max_by(|a, b| a.share_error.total_cmp(&b.share_error))
}

/// What a person should know of books that do not balance: the first lasting stage that is surely amiss, and the table.
pub fn warning(stages: &[EnergyStage]) -> Option<Warning> {
    let is_amiss = |stage: &&EnergyStage| stage.share - 2.0 * stage.share_error > LIMIT;
    let stage = lasting(stages).find(is_amiss)?;
    let lost = if stage.imbalance.iter().sum::<f64>() >= 0.0 { "is missing" } else { "is too much" };
    let message = format!(
        "after the stage {} {:.1} % of the light {lost} (standard error {:.1} %; {:.0} % may be): {}; stage by stage: {}",
        stage.name,
        100.0 * stage.share,
        100.0 * stage.share_error,
        100.0 * LIMIT,
        remedy(&stage.name),
        table(stages)
    );
    Some(Warning { code: "energy".into(), message })
}

/// What to do where a stage loses or makes light.
pub fn remedy(stage: &str) -> &'static str {
    match stage {
        "shoot" => "smaller voxels (--voxels) resolve the light near lamps and edges",
        "refresh" => "more rays (--refresh) or smaller voxels (--voxels)",
        "gather" => "a finer gather (--cut-error, --gather-rays) or smaller voxels (--voxels)",
        _ => "smaller voxels (--voxels), more directions (--directions), or --closed yes for a closed scene",
    }
}

fn table(stages: &[EnergyStage]) -> String {
    let entry = |stage: &EnergyStage| {
        let sign = if stage.imbalance.iter().sum::<f64>() < 0.0 { "+" } else { "-" };
        format!("{} {sign}{:.2} %", stage.name, 100.0 * stage.share)
    };
    stages.iter().map(entry).collect::<Vec<_>>().join(", ")
}

fn sum(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| a[i] + b[i])
}

fn times(flux: [f64; 3], factor: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| flux[i] * factor[i])
}

/// The flux of indirect light that surfels absorb [lux × squared frame units].
pub fn absorbed(surfels: &Surfels, indirect: &[Rgb]) -> DVec3 {
    flux(surfels, |i| indirect[i]) - reflected(surfels, |i| indirect[i])
}

/// The flux of light that surfels reflect [lux × squared frame units].
pub fn reflected(surfels: &Surfels, light: impl Fn(usize) -> Rgb) -> DVec3 {
    flux(surfels, |i| surfels.list[i].albedo() * light(i))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use luxel_scene::{LightKind, Silent, build::Builder};
    use luxel_transport::{
        direct::{Direct, DirectSettings},
        energy::{sent, shot},
        lights::Emitters,
        rays::Rays,
        shoot,
        solve::{SolveSettings, solve},
        surfel::{Resolution, VoxelSettings},
    };

    fn stage(name: &str, emitted: f64, absorbed: f64, in_flight: f64) -> EnergyStage {
        let all = |x: f64| [x; 3];
        EnergyStage {
            name: name.into(),
            emitted: all(emitted),
            absorbed: all(absorbed),
            in_flight: all(in_flight),
            ..EnergyStage::default()
        }
        .closed()
    }

    #[test]
    fn books_that_do_not_balance_are_noticed_by_their_first_stage() {
        let good = [stage("shoot", 1.0, 0.4, 0.6), stage("bounce 1", 1.0, 0.7, 0.295)];
        assert_eq!(warning(&good), None);
        let bad = [good[0].clone(), stage("bounce 1", 1.0, 0.7, 0.25), stage("tail", 1.0, 0.9, 0.0)];
        let said = warning(&bad).unwrap();
        assert_eq!(said.code, "energy");
        assert!(said.message.starts_with("after the stage bounce 1 5.0 % of the light is missing"), "{}", said.message);
        assert!(said.message.contains("shoot -0.00 %, bounce 1 -5.00 %, tail -10.00 %"), "{}", said.message);
        let made = [stage("shoot", 1.0, 0.6, 0.6)];
        assert!(warning(&made).unwrap().message.contains("20.0 % of the light is too much"));
        // What may be noise is no finding.
        let noisy = EnergyStage { error: [0.1; 3], ..made[0].clone() }.closed();
        assert_eq!(warning(&[noisy]), None);
        assert_eq!(worst(&bad).map(|(stage, _)| stage.name.as_str()), Some("tail"));
        // What a refresh has mended is in no lightmap; what was amiss from the start still is.
        let mended = [bad.to_vec(), vec![stage("refresh", 1.0, 1.0, 0.0)]].concat();
        assert_eq!((warning(&mended), worst(&mended).map(|(_, share)| share)), (None, Some(0.0)));
        let lost = [stage("shoot", 1.0, 0.4, 0.5), stage("bounce 1", 1.0, 0.9, 0.0), stage("refresh", 1.0, 0.9, 0.0)];
        assert!(warning(&lost).unwrap().message.starts_with("after the stage shoot 10.0 %"));
    }

    #[test]
    fn groups_of_different_length_are_added_stage_by_stage() {
        let lamp = [stage("shoot", 1.0, 0.4, 0.6), stage("bounce 1", 1.0, 0.7, 0.3), stage("bounce 2", 1.0, 0.9, 0.1)];
        let sky = [stage("bounce 1", 0.0, 2.0, 1.0), stage("tail", 0.0, 3.0, 0.0)];
        let both = joined(&lamp, &scaled(&sky, [2.0, 1.0, 0.0]));
        let names: Vec<&str> = both.iter().map(|s| s.name.as_str()).collect();
        assert_eq!(names, ["shoot", "bounce 1", "bounce 2", "tail"]);
        let absorbed: Vec<f64> = both.iter().map(|s| s.absorbed[0]).collect();
        assert_eq!(absorbed, [0.4, 4.7, 4.9, 6.9]);
        assert_eq!(both[1].absorbed, [4.7, 2.7, 0.7]);
    }

    #[test]
    fn a_lightmap_that_is_too_bright_by_a_share_is_out_by_that_share() {
        // A closed room: all that is emitted is absorbed, a fifth of what arrives.
        let mut stages = vec![stage("tail", 1.0, 1.0, 0.0)];
        let flows = Flows { received: [5.0; 3], kept: [1.0; 3], ..Flows::default() };
        gathered(&mut stages, &flows, [5.1; 3]);
        assert!((stages[1].share - 0.02).abs() < 1e-12, "{stages:?}");
        // An open one: half of what is reflected leaves.
        let mut stages = vec![stage("tail", 1.0, 0.2, 0.8)];
        let open = Flows { sent: [2.0; 3], escaped: [1.0; 3], received: [1.0; 3], kept: [0.2; 3], hidden: [0.0; 3] };
        gathered(&mut stages, &open, [1.1; 3]);
        assert!((stages[1].share - (0.02 + 0.04)).abs() < 1e-12, "{stages:?}");
    }

    #[test]
    fn what_backs_absorb_is_booked_without_a_refresh() {
        // Two plates, the upper one seen from its back, and a lamp beside them.
        let mut b = Builder::new("plates");
        let white = b.matte(Vec3::splat(0.8));
        b.quad("lower", Vec3::new(0.0, 0.0, 1.0), Vec3::X, Vec3::NEG_Z, white);
        b.quad("upper", Vec3::new(0.0, 0.5, 1.0), Vec3::X, Vec3::NEG_Z, white);
        let position = DVec3::new(0.5, 0.25, 0.5);
        b.light("bulb", LightKind::Point { position, range: None, radius: 0.0 }, Vec3::ONE);
        let scene = b.build();
        let geometry = Geometry::new(&scene);
        let rays = Rays::new(&geometry);
        let how = VoxelSettings { resolution: Resolution::Side(32), ..VoxelSettings::default() };
        let surfels = Surfels::new(&geometry, &how, &Silent).unwrap();
        let emitters = Emitters::new(&geometry);
        let direct = Direct::new(&rays, &emitters, DirectSettings::default());
        let light = shoot::exact(&geometry, &surfels, &direct, 5, &Silent).unwrap().irradiance;
        let open = shot(&rays, &emitters, &surfels, &light, &Silent).unwrap();
        let (solution, report) = solve(&surfels, &light, &SolveSettings::default(), None, &Silent).unwrap();
        let radiosity = |i: usize| surfels.list[i].albedo() * solution.total(i);
        let gone = sent(&rays, &surfels, &radiosity, &Silent).unwrap();
        let area = 1.0 / (geometry.frame.scale * geometry.frame.scale);
        let sweeps = report.ledger.scaled(area).stages;
        let warned = |gone| {
            let mut books = Books::open(Some(open));
            books.propagate(&sweeps, (report.bounces.len(), report.stiff_steps > 0), None, gone);
            warning(&books.stages).map(|warning| warning.message)
        };
        assert!(warned(None).is_some_and(|message| message.contains("is missing")));
        assert_eq!(warned(Some(&gone)), None);
    }
}
