//! A scene ready for pictures: its rays, its camera, and the laboratory in which methods find its light.

use std::cell::OnceCell;
use std::path::Path;

use glam::DVec3;
use luxel_export::{ToneMap, report::Warning, sample_lightmap};
use luxel_scene::{Camera, Progress, Scene};
use luxel_transport::{Rgb, direct::Visibility, frame::Frame, geometry::Geometry, rays::Rays};

use super::choose::choose;
use super::exposure;
use super::film::{Picture, expose};
use super::lens::{self, Lens, Size};
use super::light::{ByDraws, ByLightmap, ByMethod, Illumination};
use super::march::Look;
use super::memory;
use super::method::Way;
use super::pixel::Screen;
use super::view::View;
use crate::bake::lab::{self, Lab, Technique};
use crate::bake::{self, Lit};
use crate::settings::{Gatherer, Settings};
use crate::store::Store;
use crate::{Error, bake::with_threads};

/// What is wanted of all pictures of a scene.
#[derive(Clone, Debug)]
pub struct Order {
    pub view: View,
    pub size: Size,
    /// Samples of a pixel with an edge; 1 switches anti-aliasing off.
    pub samples: u32,
    /// EV₁₀₀; chosen by the picture where nobody says it.
    pub exposure: Option<f64>,
    /// How they will be taken, by which it is judged whether that fits into memory.
    pub ways: Vec<Way>,
}

/// Keeps a store below its cap when a picture is over, however it ends.
struct Tidied<'a>(&'a Store);

impl Drop for Tidied<'_> {
    fn drop(&mut self) {
        self.0.evict();
    }
}

/// A scene before the camera.
pub struct Studio<'a> {
    lab: &'a Lab<'a>,
    look: Look<'a>,
    lens: Lens,
    pub width: u32,
    pub height: u32,
    samples: u32,
    exposure: Option<f64>,
    store: Option<&'a Store>,
    /// By which edges are found; estimated from the first picture that is taken.
    edges: OnceCell<ToneMap>,
    /// With the continuous rays that were traced for it.
    lightmap: OnceCell<(Lit, u64)>,
    /// What a person should know of the memory that pictures take, and of the camera.
    pub warnings: Vec<Warning>,
}

impl Studio<'_> {
    /// Opens a scene file. With a store, what bakes with these settings left there is used again, and what is made is
    /// left there. Works on a pool of as many threads as the settings say.
    ///
    /// # Errors
    /// As a bake; a camera that the scene does not have; more pixels than a picture may have, or than fit into memory.
    pub fn with<T: Send>(
        path: &Path,
        settings: &Settings,
        order: &Order,
        store: Option<&Store>,
        progress: &dyn Progress,
        work: impl FnOnce(&Studio) -> Result<T, Error> + Send,
    ) -> Result<T, Error> {
        with_threads(settings, || {
            let _tidied = store.map(|store| {
                store.keep_cap_or_note();
                Tidied(store)
            });
            let scene = lab::load(path, settings, progress)?;
            Self::of(&scene, settings, order, store, progress, work)
        })
    }

    /// [`Studio::with`] of a scene in memory, on the threads of the caller.
    ///
    /// # Errors
    /// As [`Studio::with`].
    pub fn of<T>(
        scene: &Scene,
        settings: &Settings,
        order: &Order,
        store: Option<&Store>,
        progress: &dyn Progress,
        work: impl FnOnce(&Studio) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let camera = order.view.camera(scene)?;
        // Before any work.
        let (width, height) =
            order.size.of(camera.as_ref().unwrap_or(&lens::camera(DVec3::ZERO, DVec3::NEG_Z, 1.0)))?;
        let pixels = u64::from(width) * u64::from(height);
        let needs = memory::estimate(scene, settings, &order.ways, pixels, camera.is_some());
        let mut warnings = Vec::from_iter(bake::memory::check(&needs)?);
        warnings.extend(camera.as_ref().and_then(lens::narrowed));
        Lab::with(scene, settings, store, progress, |lab| {
            let whole = whole(scene);
            let geometry = whole.as_ref().map(Geometry::new);
            let rays = geometry.as_ref().map(|geometry| Rays::build(geometry, progress)).transpose()?;
            let look = Look { rays: rays.as_ref().unwrap_or(lab.rays), emission: None, sky: Rgb::ONE };
            let camera = match camera {
                Some(camera) => camera,
                None => chosen(lab, &look, progress)?,
            };
            let (width, height) = order.size.of(&camera)?;
            let lens = lens_of(&camera, &lab.rays.geometry.frame, width, height);
            let studio = Studio {
                lab,
                look,
                lens,
                width,
                height,
                samples: order.samples.max(1),
                exposure: order.exposure,
                store,
                edges: OnceCell::new(),
                lightmap: OnceCell::new(),
                warnings,
            };
            work(&studio)
        })
    }

    pub fn scene(&self) -> &Scene {
        self.lab.scene()
    }

    /// Makes the cached voxel solution ready, on which several methods rest; returns how long that took, whenever it was
    /// [s].
    ///
    /// # Errors
    /// As a bake.
    pub fn solve(&self, progress: &dyn Progress) -> Result<f64, Error> {
        Ok(self.lab.cache(progress)?.cost.seconds)
    }

    /// Takes a picture.
    ///
    /// # Errors
    /// As a bake.
    pub fn picture(&self, way: Way, progress: &dyn Progress) -> Result<Picture, Error> {
        match way {
            Way::Found(technique) => self.lab.method(technique, Visibility::Shafts, progress, |ready| {
                let picture = self.expose(&ByMethod(ready.method), 0, progress)?;
                Ok(picture.after(ready.rays))
            }),
            Way::Lightmap => {
                let (lit, rays) = self.lightmap(progress)?;
                let lookup = |instance, triangle, u, v| at(lit, instance, triangle, u, v);
                let geometry = self.look.rays.geometry;
                let light = ByLightmap { geometry, lookup: &lookup, mean: lit.sums.mean };
                Ok(self.expose(&light, 0, progress)?.after(*rays))
            }
        }
    }

    /// Makes a method that draws at random ready, once, for any number of pictures: `work` takes them one by one by the
    /// function that it gets, each with so many draws. They have samples and noise of their own, to be blended.
    ///
    /// # Errors
    /// As a bake, and those of the work.
    pub fn passes<T>(
        &self,
        technique: Technique,
        progress: &dyn Progress,
        work: impl FnOnce(&mut dyn FnMut(u32) -> Result<Picture, Error>) -> Result<T, Error>,
    ) -> Result<T, Error> {
        self.lab.method(technique, Visibility::Shafts, progress, |ready| {
            let (mut pass, mut before) = (0, ready.rays);
            work(&mut |draws| {
                let picture = self.expose(&ByDraws { method: ready.method, draws }, pass, progress)?;
                pass += 1;
                Ok(picture.after(std::mem::take(&mut before)))
            })
        })
    }

    fn expose(&self, light: &dyn Illumination, pass: u32, progress: &dyn Progress) -> Result<Picture, Error> {
        let (width, height) = (self.width, self.height);
        progress.begin("render", u64::from(width) * u64::from(height));
        let screen = Screen { look: &self.look, lens: &self.lens, width, height, samples: self.samples, pass };
        let edges = match (self.edges.get(), self.exposure) {
            (Some(edges), _) => *edges,
            (None, Some(ev)) => exposure::chosen(ev),
            (None, None) => exposure::estimate(&screen, light, progress)?,
        };
        let edges = self.edges.get_or_init(|| edges);
        Ok(expose(&screen, light, edges, progress)?)
    }

    /// How a picture is shown: as was ordered, or as it shows most.
    ///
    /// # Errors
    /// When it is no longer wanted.
    pub fn tone(&self, picture: &Picture, progress: &dyn Progress) -> Result<ToneMap, Error> {
        match self.exposure {
            Some(ev) => Ok(exposure::chosen(ev)),
            None => Ok(ToneMap::auto(&picture.radiance, progress)?),
        }
    }

    fn lightmap(&self, progress: &dyn Progress) -> Result<&(Lit, u64), Error> {
        if let Some(lit) = self.lightmap.get() {
            return Ok(lit);
        }
        let lit = bake::lightmaps(self.lab.scene(), self.lab.settings, self.store, progress)?;
        Ok(self.lightmap.get_or_init(|| lit))
    }
}

fn lens_of(camera: &Camera, frame: &Frame, width: u32, height: u32) -> Lens {
    Lens::new(camera, frame, f64::from(width) / f64::from(height))
}

/// The scene with all that blocks no light, so that it is seen; none where rays meet everything anyway.
fn whole(scene: &Scene) -> Option<Scene> {
    if scene.instances.iter().all(|i| i.casts) {
        return None;
    }
    let mut whole = scene.clone();
    whole.instances.iter_mut().for_each(|i| i.casts = true);
    Some(whole)
}

/// The view of a scene without a camera, by the light of its voxel solution: the same for all methods.
fn chosen(lab: &Lab, look: &Look, progress: &dyn Progress) -> Result<Camera, Error> {
    let solution = &lab.cache(progress)?.solution;
    let lit = solution.direct.iter().zip(&solution.indirect).map(|(d, i)| f64::from((*d + *i).max_element()));
    let (sum, count) = lit.filter(|e| *e > 0.0).fold((0.0, 0u32), |(sum, count), e| (sum + e, count + 1));
    let typical = (sum / f64::from(count.max(1))) as f32;
    lab.method(Technique::Cached(Gatherer::Lookup), Visibility::Rays, progress, |ready| {
        Ok(choose(look, &ByMethod(ready.method), typical, progress)?)
    })
}

/// The finished lightmap at a point of an instance.
pub fn at(lit: &Lit, instance: u32, triangle: u32, u: f32, v: f32) -> Option<Rgb> {
    let placed = lit.atlas.placed.get(instance as usize)?.as_ref()?;
    let corners = placed.triangles.get(triangle as usize)?;
    let [a, b, c] = corners.map(|i| placed.uvs[i as usize]);
    let uv = a * (1.0 - u - v) + b * u + c * v;
    Some(sample_lightmap(&lit.lightmaps, placed.page, uv))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::method::{Chosen, METHODS};
    use crate::settings::{
        Only, Voxels,
        value::{Samples, Texels},
    };
    use crate::store::StoreOptions;
    use glam::Vec3;
    use luxel_scene::{Material, Silent, Sky, build::Builder};

    fn settings() -> Settings {
        let medium = Settings::default();
        Settings { size: Texels(64), voxels: Voxels::Budget(4000), directions: Samples(128), ..medium }
    }

    fn order(eye: DVec3, target: DVec3) -> Order {
        let size = Size { width: Some(24), height: Some(16) };
        Order { view: View::from(eye, target, 70.0).unwrap(), size, samples: 16, exposure: None, ways: Vec::new() }
    }

    /// Pictures by every method, with few draws.
    fn pictures(scene: &Scene, order: &Order) -> Vec<(&'static str, Picture)> {
        let all = |studio: &Studio| {
            let by = |entry: &'static crate::render::method::Entry| {
                let draws = entry.draws.map_or(0, |d| d.usual);
                let chosen = Chosen { entry, draws };
                Ok((entry.name, studio.picture(chosen.way(draws), &Silent)?))
            };
            METHODS.iter().map(by).collect()
        };
        Studio::of(scene, &settings(), order, None, &Silent, all).unwrap()
    }

    /// Everything in a closed box of albedo ρ that shines with Lₑ shows Lₑ/(1 − ρ), whoever looks.
    #[test]
    fn a_furnace_shows_the_same_radiance_everywhere_by_every_method() {
        let mut b = Builder::new("furnace");
        let glow = b.emitter(Vec3::splat(0.5), Vec3::ONE);
        b.cuboid("box", Vec3::ZERO, Vec3::new(3.0, 2.0, 4.0), glow, true);
        let scene = b.build();
        for (name, picture) in pictures(&scene, &order(DVec3::new(0.7, 0.8, 0.4), DVec3::new(1.9, 1.1, 3.8))) {
            assert!(picture.spent.rays > 0, "{name} counts no rays");
            // An error that is estimated from two values may be small by chance; over all pixels it is not.
            let stated = (picture.relative_error().unwrap_or(0.0) * picture.mean_reflected()) as f32;
            let far = |l: &Rgb| (*l - Rgb::splat(2.0)).abs().max_element();
            // A photon map draws at random and states no error: its pictures spread by less than 1 % with the usual
            // number of photons, and none of their pixels by five times as much as all together.
            let square = picture.radiance.iter().map(|l| far(l) * far(l)).sum::<f32>() / picture.radiance.len() as f32;
            let spread = square.sqrt();
            assert!(name != "photons" || spread < 0.02, "{spread}");
            let typical = if name == "photons" { spread } else { stated };
            let beyond = |(l, e): (&Rgb, &f32)| far(l) - 5.0 * e.max(typical);
            let worst = picture.radiance.iter().zip(&picture.error).map(beyond).fold(0.0, f32::max);
            let mean = picture.radiance.iter().map(|l| l.x).sum::<f32>() / picture.radiance.len() as f32;
            println!("{name}: mean {mean}, standard error {typical}, worst {worst} beyond five of them");
            assert!(worst <= 0.02 && (mean - 2.0).abs() <= 0.01, "{name}: {worst} {mean}");
        }
    }

    /// A white plane under an even sky shows ρL, whether its light is the sky's own or that of a cache.
    #[test]
    fn a_plane_under_an_even_sky_shows_it_by_every_method_and_the_sky_is_exact() {
        let mut b = Builder::new("plane");
        let grey = b.matte(Vec3::splat(0.6));
        b.quad("plane", Vec3::new(-9.0, 0.0, 9.0), Vec3::X * 18.0, Vec3::NEG_Z * 18.0, grey);
        b.scene_mut().sky = Sky::Constant(Vec3::new(1.0, 2.0, 4.0));
        let scene = b.build();
        for (name, picture) in pictures(&scene, &order(DVec3::new(0.0, 2.0, 5.0), DVec3::new(0.0, 0.0, -4.0))) {
            let (top, bottom) = (picture.radiance[12], picture.radiance[15 * 24 + 12]);
            assert_eq!(top, Rgb::new(1.0, 2.0, 4.0), "{name}");
            assert!((bottom / top - 0.6).abs().max_element() < 0.012, "{name}: {}", bottom / top);
        }
    }

    #[test]
    fn the_back_of_a_double_sided_sheet_is_lit_from_its_own_side() {
        let mut b = Builder::new("sheet");
        let paper = b.material(Material {
            base_color: Vec3::splat(0.5).extend(1.0),
            double_sided: true,
            ..Material::default()
        });
        // Its front looks up, away from the lamp.
        b.quad("sheet", Vec3::new(-1.0, 0.0, 1.0), Vec3::X * 2.0, Vec3::NEG_Z * 2.0, paper);
        let kind = luxel_scene::LightKind::Point { position: DVec3::NEG_Y, range: None, radius: 0.0 };
        b.light("lamp", kind, Vec3::splat(10.0));
        let scene = b.build();
        let look = |eye| {
            let order = order(eye, DVec3::ZERO);
            let chosen = Chosen { entry: &METHODS[0], draws: 0 };
            let middle = |p: Picture| p.radiance[8 * 24 + 12].x;
            let picture = |studio: &Studio| studio.picture(chosen.way(0), &Silent);
            middle(Studio::of(&scene, &settings(), &order, None, &Silent, picture).unwrap())
        };
        assert!(look(DVec3::new(0.0, 2.0, 0.1)) < 1e-3, "the front is dark");
        let below = look(DVec3::new(0.0, -2.0, 0.1));
        let expected = 10.0 * 0.5 / std::f32::consts::PI;
        assert!((below / expected - 1.0).abs() < 0.05, "{below} {expected}");
    }

    /// What a lightmap holds, and whether anything has one, is nothing to methods that find light where it is seen; nor
    /// is what was stored.
    #[test]
    fn all_light_is_seen_whatever_a_lightmap_would_hold() {
        let cornell = luxel_assets::cornell();
        let mut unmapped = cornell.clone();
        unmapped.instances.iter_mut().for_each(|i| i.receives = false);
        let size = Size { width: Some(8), height: Some(8) };
        let order = Order { view: View::Scene, size, samples: 1, exposure: Some(3.0), ways: Vec::new() };
        let take = |scene: &Scene, only: Only, store: Option<&Store>| {
            let settings = Settings { only, voxels: Voxels::Budget(1500), directions: Samples(64), ..settings() };
            let picture = |studio: &Studio| studio.picture(Way::Found(Technique::Voxels), &Silent);
            Studio::of(scene, &settings, &order, store, &Silent, picture).unwrap()
        };
        let folder = tempfile::tempdir().unwrap();
        let store = StoreOptions::default().open(folder.path());
        let all = take(&cornell, Only::All, None);
        assert!(all.mean_reflected() > 0.0);
        assert_eq!(take(&cornell, Only::Direct, None), all);
        // The first one fills the store, the second one reads it.
        for only in [Only::Direct, Only::All] {
            let stored = take(&cornell, only, Some(&store));
            assert_eq!((stored.radiance, stored.reflected), (all.radiance.clone(), all.reflected.clone()));
        }
        assert_eq!(take(&unmapped, Only::All, None).radiance, all.radiance);
    }

    #[test]
    fn what_blocks_no_light_is_seen_all_the_same() {
        let mut b = Builder::new("ghost");
        let glow = b.emitter(Vec3::ZERO, Vec3::ONE);
        b.quad("ghost", Vec3::new(-1.0, -1.0, 0.0), Vec3::X * 2.0, Vec3::Y * 2.0, glow);
        b.scene_mut().instances[0].casts = false;
        let scene = b.build();
        let chosen = Chosen { entry: &METHODS[0], draws: 0 };
        let order = order(DVec3::Z * 2.0, DVec3::ZERO);
        let picture = |studio: &Studio| studio.picture(chosen.way(0), &Silent);
        let picture = Studio::of(&scene, &settings(), &order, None, &Silent, picture).unwrap();
        assert_eq!(picture.radiance[8 * 24 + 12], Rgb::ONE);
    }

    #[test]
    fn passes_differ_and_their_blend_is_the_same_every_time() {
        let scene = luxel_assets::cornell();
        let size = Size { width: Some(12), height: Some(12) };
        let order = Order { view: View::Scene, size, samples: 4, exposure: Some(3.0), ways: Vec::new() };
        // As many as it is told, whatever it was made for.
        let technique = Technique::PathTracing { paths: 1 };
        let take = || {
            let both = |studio: &Studio| {
                studio.passes(technique, &Silent, |take| {
                    let (mut first, second) = (take(4)?, take(4)?);
                    assert!(first.radiance != second.radiance);
                    first.blend(&second, 0.5);
                    Ok(first)
                })
            };
            Studio::of(&scene, &settings(), &order, None, &Silent, both).unwrap()
        };
        assert!(take() == take());
        let once = |studio: &Studio| studio.picture(Way::Found(Technique::PathTracing { paths: 4 }), &Silent);
        let once = Studio::of(&scene, &settings(), &order, None, &Silent, once).unwrap();
        let first = |studio: &Studio| studio.passes(technique, &Silent, |take| take(4));
        assert!(once == Studio::of(&scene, &settings(), &order, None, &Silent, first).unwrap());
    }
}
