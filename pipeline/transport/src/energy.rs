//! Where the light is after every stage, so that a stage that loses or makes light is seen.
//!
//! ```text
//! emitted + sky = absorbed + escaped + in flight + imbalance
//! ```
//!
//! band by band and summed over all stages so far. `in flight` is what surfels reflect and nobody has propagated yet.
//! No term is found by the balance itself, so the imbalance is what really is amiss:
//!
//! | term | from |
//! |---|---|
//! | emitted | the lights' own power, Φ = πLA of surfaces and ∫I dω of lamps; of suns the flux through the silhouette of the scene, by photons |
//! | sky | cosine-distributed rays from points of the surfels: Φ = A·π·mean(L T) over those that leave the scene |
//! | absorbed, in flight | (1 − ρ) and ρ of the flux Σ A·E at surfels; absorbed also the backs and veils that photons meet |
//! | escaped | of the lights' own light photons that leave the scene; of what a sweep sends the share of sky that a sweep of its own sees; of all reflected light, once it is refreshed, photons from the surfels |
//!
//! Backs of single-sided surfaces absorb, and only rays meet them: sweeps and refreshes balance with what photons from
//! the surfels lose there ([`sent`]).
//!
//! The estimates of photons and sky rays are means of [`REPEATS`] independent lattices, whose spread gives their
//! standard error. Fluxes are irradiance [lux] × squared scene units: lumens where these are metres.

use std::f64::consts::PI;

use glam::DVec3;
use luxel_scene::{Cancelled, Progress};
use rayon::prelude::*;

use crate::{
    Rgb,
    ledger::{Stage, flux},
    lights::Emitters,
    rays::{Rays, leave},
    sampling::{basis, combine, cosine_hemisphere, mix, r2, unit, unit2},
    shoot::{
        self,
        emission::{self, Beam},
    },
    surfel::Surfels,
    sweep::SkyFn,
};

/// Independent estimates whose mean is taken.
pub const REPEATS: u32 = 8;

/// Photons of one of them, and those from one point: few, because only their sum counts, however many lights there are.
const SHONE: (u32, u32) = (1 << 14, 16);

/// Photons from surfels of one of them.
const SENT: u32 = 8192;

/// Rays towards the sky of one of them.
const SKY_RAYS: u32 = 8192;

/// Rays between two looks at the progress.
const CHUNK: u32 = 1024;

/// Mixed into the seeds of the estimates, which must not be those of what they judge.
const SEED: u64 = 0x1ed6_e400;

/// Where the light is, by band [lm]; cumulative.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Balance {
    pub emitted: DVec3,
    pub sky: DVec3,
    pub absorbed: DVec3,
    pub escaped: DVec3,
    pub in_flight: DVec3,
    /// Standard error of the estimates among these.
    pub error: DVec3,
}

impl Balance {
    /// Light that was lost (positive) or made (negative) so far.
    pub fn imbalance(&self) -> DVec3 {
        self.emitted + self.sky - self.absorbed - self.escaped - self.in_flight
    }

    /// The books after a sweep that sent some of what was in flight.
    pub fn after(self, sweep: &Stage) -> Self {
        Self {
            absorbed: self.absorbed + sweep.arrived - sweep.reflected,
            escaped: self.escaped + sweep.escaped,
            in_flight: self.in_flight + sweep.reflected - sweep.sent,
            ..self
        }
    }

    /// The same with light from the sky, known with a standard error.
    pub fn with_sky(self, (sky, error): (DVec3, DVec3)) -> Self {
        Self { sky: self.sky + sky, error: (self.error * self.error + error * error).map(f64::sqrt), ..self }
    }

    /// Every flux times a factor.
    pub fn scaled(self, factor: f64) -> Self {
        Self {
            emitted: self.emitted * factor,
            sky: self.sky * factor,
            absorbed: self.absorbed * factor,
            escaped: self.escaped * factor,
            in_flight: self.in_flight * factor,
            error: self.error * factor.abs(),
        }
    }
}

/// The books after the shooting: `direct` is the irradiance of every surfel straight from the lights, however it was
/// found. Photons of their own tell how much of the lights' flux never comes to a surfel.
pub fn shot(
    rays: &Rays,
    emitters: &Emitters,
    surfels: &Surfels,
    direct: &[Rgb],
    progress: &dyn Progress,
) -> Result<Balance, Cancelled> {
    if emitters.is_empty() {
        return Ok(Balance::default());
    }
    let near = Lost::near(rays, emitters, surfels, progress)?;
    let far = Lost::far(rays, emitters, surfels, progress)?;
    let area = 1.0 / (emitters.scale * emitters.scale);
    let arrived = flux(surfels, |i| direct[i]) * area;
    let reflected = flux(surfels, |i| surfels.list[i].albedo() * direct[i]) * area;
    Ok(Balance {
        emitted: near.emitted + far.emitted,
        sky: DVec3::ZERO,
        // A veil is lit by light that it also lets through: that share is not kept by it.
        absorbed: arrived - reflected + near.absorbed + far.absorbed - near.twice - far.twice,
        escaped: near.escaped + far.escaped,
        in_flight: reflected,
        error: (near.error * near.error + far.error * far.error).map(f64::sqrt),
    })
}

/// What photons say of light that comes to no surfel [lm].
#[derive(Clone, Copy, Default)]
struct Lost {
    emitted: DVec3,
    escaped: DVec3,
    absorbed: DVec3,
    /// Booked at a surfel and passed on all the same.
    twice: DVec3,
    error: DVec3,
}

impl Lost {
    /// Of surfaces and lamps, whose power is known: photons tell shares of it.
    fn near(rays: &Rays, emitters: &Emitters, surfels: &Surfels, progress: &dyn Progress) -> Result<Self, Cancelled> {
        let power = emitters.power();
        Self::mean(rays, &emission::near(emitters), surfels, progress, |one| {
            let band = |b: usize| if one.emitted[b] > 0.0 { power[b] / one.emitted[b] } else { 0.0 };
            let scale = DVec3::new(band(0), band(1), band(2));
            Self {
                emitted: power,
                escaped: one.escaped * scale,
                absorbed: one.absorbed * scale,
                twice: one.twice * scale,
                error: DVec3::ZERO,
            }
        })
    }

    /// Of suns: what passes beside the scene was never sent to it.
    fn far(rays: &Rays, emitters: &Emitters, surfels: &Surfels, progress: &dyn Progress) -> Result<Self, Cancelled> {
        Self::mean(rays, &emission::far(rays.geometry, emitters), surfels, progress, |one| Self {
            emitted: one.emitted - one.escaped,
            escaped: DVec3::ZERO,
            ..one
        })
    }

    /// The mean of independent passes; its error is that of what should have arrived.
    fn mean(
        rays: &Rays,
        beams: &[Beam],
        surfels: &Surfels,
        progress: &dyn Progress,
        view: impl Fn(Self) -> Self,
    ) -> Result<Self, Cancelled> {
        if beams.iter().all(|beam| beam.power <= 0.0) {
            return Ok(Self::default());
        }
        let area = 1.0 / (rays.geometry.frame.scale * rays.geometry.frame.scale);
        let (mut sum, mut passes) = (Self::default(), Vec::new());
        for repeat in 0..REPEATS {
            let (photons, directions) = SHONE;
            let how = (photons, directions, SEED + u64::from(repeat));
            let (flux, twice) = shoot::photons::shone(rays, surfels, beams, how, progress)?;
            let one = view(Self {
                emitted: flux.emitted * area,
                escaped: flux.escaped * area,
                absorbed: flux.absorbed * area,
                twice: twice * area,
                error: DVec3::ZERO,
            });
            passes.push(one.emitted - one.escaped - one.absorbed + one.twice);
            sum.emitted += one.emitted;
            sum.escaped += one.escaped;
            sum.absorbed += one.absorbed;
            sum.twice += one.twice;
        }
        let scale = 1.0 / f64::from(REPEATS);
        Ok(Self {
            emitted: sum.emitted * scale,
            escaped: sum.escaped * scale,
            absorbed: sum.absorbed * scale,
            twice: sum.twice * scale,
            error: standard_error(&passes),
        })
    }
}

/// What becomes of the light that surfels send, but for what arrives at surfels [lm].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gone {
    pub sent: DVec3,
    pub escaped: DVec3,
    /// By backs of single-sided surfaces and by veils, less what surfels of veils book although it goes on.
    pub absorbed: DVec3,
    /// Standard error of both together.
    pub error: DVec3,
}

/// Where all reflected light goes that comes to no surfel: `radiosity` [lm/m²] by surfel.
pub fn sent(
    rays: &Rays,
    surfels: &Surfels,
    radiosity: &dyn Fn(usize) -> Rgb,
    progress: &dyn Progress,
) -> Result<Gone, Cancelled> {
    let area = 1.0 / (rays.geometry.frame.scale * rays.geometry.frame.scale);
    let (mut gone, mut passes) = (Gone::default(), Vec::new());
    for repeat in 0..REPEATS {
        let seed = combine(SEED ^ 0x5e47, u64::from(repeat));
        let (flux, twice) = shoot::photons::sent(rays, surfels, radiosity, (SENT, seed), progress)?;
        // The sum over all surfels is known; photons tell shares of it.
        gone.escaped += flux.escaped * area;
        gone.absorbed += (flux.absorbed - twice) * area;
        passes.push((flux.escaped + flux.absorbed - twice) * area);
    }
    let scale = 1.0 / f64::from(REPEATS);
    Ok(Gone {
        sent: flux(surfels, radiosity) * area,
        escaped: gone.escaped * scale,
        absorbed: gone.absorbed * scale,
        error: standard_error(&passes),
    })
}

/// Flux from the sky to all surfels, and its standard error [lm]; `radiance` [cd/m²] by the direction towards the sky,
/// `scale` frame units per scene unit.
pub fn sky(
    rays: &Rays,
    surfels: &Surfels,
    radiance: SkyFn,
    progress: &dyn Progress,
) -> Result<(DVec3, DVec3), Cancelled> {
    let mut ends = Vec::with_capacity(surfels.list.len());
    let mut area = 0.0f64;
    for surfel in &surfels.list {
        area += f64::from(surfel.area);
        ends.push(area);
    }
    if area <= 0.0 {
        return Ok((DVec3::ZERO, DVec3::ZERO));
    }
    let scale = rays.geometry.frame.scale;
    let whole = PI * area / (scale * scale * f64::from(SKY_RAYS));
    let mut passes = Vec::new();
    for repeat in 0..REPEATS {
        let seed = combine(SEED, u64::from(repeat));
        let mut sum = DVec3::ZERO;
        for first in (0..SKY_RAYS).step_by(CHUNK as usize) {
            progress.check()?;
            let one = |k: u32| sky_ray(rays, surfels, &ends, radiance, (k, seed));
            let found: Vec<DVec3> = (first..first + CHUNK).into_par_iter().map(one).collect();
            sum += found.into_iter().sum::<DVec3>();
        }
        passes.push(sum * whole);
    }
    let mean = passes.iter().sum::<DVec3>() / f64::from(REPEATS);
    Ok((mean, standard_error(&passes)))
}

/// The radiance that comes along ray `k` of a pass: from the surfel at an even place of the area.
fn sky_ray(rays: &Rays, surfels: &Surfels, ends: &[f64], radiance: SkyFn, (k, seed): (u32, u64)) -> DVec3 {
    let place = (f64::from(k) + f64::from(unit(combine(seed, u64::from(k))))) / f64::from(SKY_RAYS);
    let wanted = place * ends.last().copied().unwrap_or_default();
    let surfel = &surfels.list[ends.partition_point(|end| *end <= wanted).min(ends.len() - 1)];
    let (point, normal) = surfel.place(rays.geometry);
    // The lattice runs over neighbours; a hash apart from it would only add noise.
    let direction = (basis(normal) * cosine_hemisphere(r2(k, unit2(mix(seed))))).normalize_or(normal);
    let open = rays.transmittance(leave(point, normal, direction), direction, f32::INFINITY);
    if open == Rgb::ZERO { DVec3::ZERO } else { (open * radiance(direction)).as_dvec3() }
}

/// Of the mean of independent values: √(Σ(x − x̄)²/(n(n − 1))).
fn standard_error(values: &[DVec3]) -> DVec3 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<DVec3>() / n;
    let square: DVec3 = values.iter().map(|x| (*x - mean) * (*x - mean)).sum();
    (square / (n * (n - 1.0))).map(f64::sqrt)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        direct::{Direct, DirectSettings},
        geometry::Geometry,
        surfel::{Resolution, VoxelSettings},
    };
    use glam::{Vec3, Vec4};
    use luxel_scene::{Alpha, LightKind, Material, Scene, Silent, Texture, TextureRef, build::Builder};

    /// The surfels of a scene with their exact direct light.
    fn books(scene: &Scene) -> (Balance, f64) {
        let geometry = Geometry::new(scene);
        let rays = Rays::new(&geometry);
        let how = VoxelSettings { resolution: Resolution::Side(24), ..VoxelSettings::default() };
        let surfels = Surfels::new(&geometry, &how, &Silent).unwrap();
        let emitters = Emitters::new(&geometry);
        let direct = Direct::new(&rays, &emitters, DirectSettings::default());
        let exact = shoot::exact(&geometry, &surfels, &direct, 5, &Silent).unwrap().irradiance;
        let books = shot(&rays, &emitters, &surfels, &exact, &Silent).unwrap();
        let share = books.imbalance().abs().element_sum() / books.emitted.element_sum();
        println!("{}: {books:?}: {:.3} %", scene.name, 100.0 * share);
        (books, share)
    }

    fn room(name: &str, lit: impl Fn(&mut Builder)) -> Scene {
        let mut b = Builder::new(name);
        let wall = b.matte(Vec3::new(0.7, 0.5, 0.3));
        b.cuboid("shell", Vec3::ZERO, Vec3::new(1.0, 0.8, 1.2), wall, true);
        lit(&mut b);
        b.build()
    }

    #[test]
    fn in_a_closed_room_all_flux_of_a_lamp_arrives() {
        let kind = LightKind::Point { position: DVec3::new(0.4, 0.5, 0.7), range: None, radius: 0.0 };
        let (books, share) = books(&room("bulb", |b| b.light("bulb", kind, Vec3::new(1.0, 2.0, 3.0))));
        let expected = 4.0 * PI * DVec3::new(1.0, 2.0, 3.0);
        assert!((books.emitted / expected - 1.0).abs().max_element() < 1e-6);
        assert_eq!(books.escaped, DVec3::ZERO);
        assert!(share < 0.01, "{share}");
    }

    #[test]
    fn what_leaves_through_a_hole_is_escaped() {
        let scene = room("panel", |b| {
            let glow = b.emitter(Vec3::splat(0.5), Vec3::splat(10.0));
            b.quad("panel", Vec3::new(0.3, 0.7, 0.3), Vec3::X * 0.3, Vec3::Z * 0.3, glow);
        });
        let mut open = scene.clone();
        // One wall of six.
        open.meshes[0].triangles.truncate(10);
        let ((closed, share), (open, open_share)) = (books(&scene), books(&open));
        assert!(closed.escaped.max_element() < 1e-9 && open.escaped.x > 0.02 * open.emitted.x, "{open:?}");
        assert!(share < 0.01 && open_share < 0.01, "{share} {open_share}");
    }

    #[test]
    fn the_books_of_many_lights_know_what_escapes() {
        // Without the wall at z = 1.2, so that photons tell something.
        let scene = room("stars", |b| {
            for i in 0..2000u32 {
                let p = r2(i, unit2(5)).as_dvec2();
                let position = DVec3::new(0.1 + 0.8 * p.x, 0.4, 0.1 + p.y);
                let kind = LightKind::Point { position, range: None, radius: 0.0 };
                b.light(&format!("star {i}"), kind, Vec3::new(1.0, 2.0, 3.0) * (1 + i % 9) as f32);
            }
        });
        let mut open = scene;
        open.meshes[0].triangles.truncate(10);
        let geometry = Geometry::new(&open);
        let rays = Rays::new(&geometry);
        let how = VoxelSettings { resolution: Resolution::Side(12), ..VoxelSettings::default() };
        let surfels = Surfels::new(&geometry, &how, &Silent).unwrap();
        let emitters = Emitters::new(&geometry);
        let escaped = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| Lost::near(&rays, &emitters, &surfels, &Silent).unwrap())
        };
        let found = escaped(1);
        assert_eq!(found.escaped, escaped(7).escaped);
        assert!(found.error.x < 0.002 * found.emitted.x, "{} of {}", found.error, found.emitted);
        let settings = shoot::PhotonSettings { primary: 2000, directions: 256 };
        let exact = shoot::photons(&rays, &emitters, &surfels, settings, &Silent).unwrap();
        let share = (found.escaped - exact.ledger.escaped).abs() / found.emitted;
        assert!(share.max_element() < 0.004, "{} {}", found.escaped, exact.ledger.escaped);
    }

    /// Φ = 2πI((cos i − cos o)/3 + 1 − cos i): the falloff is the square of a straight line in the cosine.
    #[test]
    fn all_of_a_spot_arrives_or_leaves_by_where_it_points() {
        // On the far wall its disc is eight voxels wide.
        let (inner, outer) = (0.1f64, 0.2f64);
        let spot = |direction: DVec3| {
            let position = DVec3::new(0.4, 0.5, 1.0);
            let kind = LightKind::Spot { position, direction, inner, outer, range: None, radius: 0.0 };
            let mut scene = room("spot", |b| b.light("spot", kind, Vec3::new(1.0, 2.0, 3.0)));
            // The wall at z = 1.2 is open.
            scene.meshes[0].triangles.truncate(10);
            books(&scene)
        };
        let (narrow, wide) = (libm::cos(inner), libm::cos(outer));
        let expected = 2.0 * PI * ((narrow - wide) / 3.0 + 1.0 - narrow) * DVec3::new(1.0, 2.0, 3.0);
        let (away, _) = spot(DVec3::Z);
        let is = |found: DVec3| (found / expected - 1.0).abs().max_element() < 1e-5;
        assert!(is(away.emitted) && is(away.escaped), "{away:?}, not {expected}");
        assert_eq!((away.absorbed, away.in_flight), (DVec3::ZERO, DVec3::ZERO));
        let (inside, share) = spot(DVec3::NEG_Z);
        assert!(is(inside.emitted) && inside.escaped == DVec3::ZERO && share < 0.01, "{inside:?} {share}");
    }

    /// A veil of coverage c keeps c(1 − ρ) and what its tint takes, reflects cρ, and passes T to a floor whose texture is
    /// half dark and half bright.
    #[test]
    fn a_sun_through_a_veil_is_booked_once() {
        let mut b = Builder::new("veil");
        let texel = |x: u32| if x < 32 { [51, 51, 51, 255] } else { [204, 204, 204, 255] };
        let texels = (0..64).map(texel).collect();
        b.scene_mut().textures.push(Texture { name: "halves".into(), width: 64, height: 1, srgb: false, texels });
        let halves = b.material(Material {
            base_color: Vec4::ONE,
            base_color_texture: Some(TextureRef::new(0)),
            ..Material::default()
        });
        let tint = Vec3::new(0.8, 0.4, 0.2);
        let veil = b.material(Material { base_color: tint.extend(0.5), alpha: Alpha::Blend, ..Material::default() });
        b.quad("floor", Vec3::ZERO, Vec3::Z * 2.0, Vec3::X * 2.0, halves);
        b.quad("veil", Vec3::Y * 0.5, Vec3::Z * 2.0, Vec3::X * 2.0, veil);
        b.light("sun", LightKind::Sun { direction: DVec3::NEG_Y, angle: 0.0 }, Vec3::splat(100.0));
        let (books, share) = books(&b.build());
        let passes = 0.5 * Vec3::ONE.lerp(tint, 0.5);
        let expected = (0.5 * tint + 0.5 * passes).as_dvec3();
        assert!((books.in_flight / 400.0 - expected).abs().max_element() < 0.005, "{books:?}, not {expected}");
        assert!((books.emitted / 400.0 - 1.0).abs().max_element() < 0.01 && share < 0.01, "{books:?} {share}");
        assert!((books.absorbed / 400.0 - (1.0 - expected)).abs().max_element() < 0.01, "{books:?}");
    }

    #[test]
    fn a_suns_flux_is_what_the_silhouette_takes() {
        let mut b = Builder::new("sun");
        let grey = b.matte(Vec3::splat(0.5));
        b.quad("floor", Vec3::ZERO, Vec3::Z * 2.0, Vec3::X * 3.0, grey);
        // The light comes down at 60° to the floor.
        let direction = DVec3::new(0.5, -(0.75f64.sqrt()), 0.0);
        b.light("sun", LightKind::Sun { direction, angle: 0.0 }, Vec3::splat(100.0));
        let (books, share) = books(&b.build());
        let expected = 100.0 * 6.0 * 0.75f64.sqrt();
        assert!((books.emitted.x / expected - 1.0).abs() < 0.01, "{books:?}, not {expected}");
        assert!(books.error.x < 0.01 * expected && share < 0.01, "{books:?} {share}");
    }

    #[test]
    fn light_that_surfels_do_not_have_is_missed() {
        let kind = LightKind::Point { position: DVec3::new(0.4, 0.5, 0.7), range: None, radius: 0.0 };
        let scene = room("dim", |b| b.light("bulb", kind, Vec3::ONE));
        let geometry = Geometry::new(&scene);
        let rays = Rays::new(&geometry);
        let how = VoxelSettings { resolution: Resolution::Side(12), ..VoxelSettings::default() };
        let surfels = Surfels::new(&geometry, &how, &Silent).unwrap();
        let dark = vec![Rgb::ZERO; surfels.list.len()];
        let books = shot(&rays, &Emitters::new(&geometry), &surfels, &dark, &Silent).unwrap();
        assert!((books.imbalance().x / books.emitted.x - 1.0).abs() < 1e-6, "{books:?}");
    }

    #[test]
    fn the_sky_over_a_plane_sends_pi_l_a() {
        let mut b = Builder::new("plane");
        let grey = b.matte(Vec3::splat(0.5));
        b.quad("plane", Vec3::ZERO, Vec3::Z * 2.0, Vec3::X * 3.0, grey);
        let scene = b.build();
        let geometry = Geometry::new(&scene);
        let rays = Rays::new(&geometry);
        let how = VoxelSettings { resolution: Resolution::Side(12), ..VoxelSettings::default() };
        let surfels = Surfels::new(&geometry, &how, &Silent).unwrap();
        let l = Rgb::new(1.0, 0.5, 0.25);
        let (found, error) = sky(&rays, &surfels, &|_| l, &Silent).unwrap();
        let expected = l.as_dvec3() * 6.0 * PI;
        // Voxel clipping costs 1e-4 of the area at most.
        assert!((found / expected - 1.0).abs().max_element() < 2e-4, "{found} {expected}");
        assert!(error.max_element() < 1e-6 * expected.x, "{error}");
        // A gradient's own noise is stated.
        let (found, error) = sky(&rays, &surfels, &|d| l * d.y, &Silent).unwrap();
        let expected = expected * (2.0 / 3.0);
        assert!((found - expected).abs().max_element() < 4.0 * error.max_element() + 2e-4 * expected.x, "{found}");
    }

    #[test]
    fn a_sweep_moves_light_from_flight_to_walls() {
        let start = Balance {
            emitted: DVec3::ONE,
            absorbed: DVec3::splat(0.4),
            in_flight: DVec3::splat(0.6),
            ..Balance::default()
        };
        let sweep = Stage {
            sent: DVec3::splat(0.6),
            escaped: DVec3::splat(0.1),
            arrived: DVec3::splat(0.45),
            reflected: DVec3::splat(0.2),
            ..Stage::default()
        };
        let end = start.after(&sweep);
        assert!((end.imbalance() - 0.05).abs().max_element() < 1e-12, "{end:?}");
        assert!((end.in_flight - 0.2).abs().max_element() < 1e-12, "{end:?}");
    }

    #[test]
    fn backs_absorb_what_a_plate_sends_to_them_and_the_rest_escapes() {
        // Two squares of side 1 at a distance of 1, the upper one seen from its back: F = 0.199825.
        let mut b = Builder::new("plates");
        let grey = b.matte(Vec3::new(0.5, 0.25, 0.75));
        b.quad("lower", Vec3::new(0.0, 0.0, 1.0), Vec3::X, Vec3::NEG_Z, grey);
        b.quad("upper", Vec3::new(0.0, 1.0, 1.0), Vec3::X, Vec3::NEG_Z, grey);
        let scene = b.build();
        let geometry = Geometry::new(&scene);
        let rays = Rays::new(&geometry);
        let how = VoxelSettings { resolution: Resolution::Side(24), ..VoxelSettings::default() };
        let surfels = Surfels::new(&geometry, &how, &Silent).unwrap();
        let lower = |i: usize| surfels.list[i].centroid.y < 0.0;
        let radiosity = |i: usize| if lower(i) { surfels.list[i].albedo() } else { Rgb::ZERO };
        let gone = sent(&rays, &surfels, &radiosity, &Silent).unwrap();
        let all = DVec3::new(0.5, 0.25, 0.75);
        assert!((gone.sent / all - 1.0).abs().max_element() < 1e-5, "{gone:?}");
        assert!((gone.absorbed + gone.escaped - gone.sent).abs().max_element() < 1e-5, "{gone:?}");
        let off = (gone.absorbed / all - 0.199825).abs().max_element();
        println!("backs absorb {:.5} of 0.19983", gone.absorbed.x / all.x);
        assert!(off < 0.002, "{off}");
        // What arrives at surfels is not gone, and no light goes nowhere.
        let closed = room("closed", |_| {});
        let geometry = Geometry::new(&closed);
        let rays = Rays::new(&geometry);
        let surfels = Surfels::new(&geometry, &how, &Silent).unwrap();
        let gone = sent(&rays, &surfels, &|_| Rgb::ONE, &Silent).unwrap();
        assert_eq!((gone.escaped, gone.absorbed, gone.error), (DVec3::ZERO, DVec3::ZERO, DVec3::ZERO));
        assert_eq!(sent(&rays, &surfels, &|_| Rgb::ZERO, &Silent).unwrap(), Gone::default());
    }
}
