//! A picture of the scene as an engine would show it with its lightmap, so that one look tells whether a bake is right.
//!
//! Along each primary ray L = Σ τ·c·(Lₑ + ρE/π): veils are passed with their transmittance τ and weighed by their
//! coverage c, backs of single-sided surfaces are culled as engines do (so a closed room can be seen from outside), and
//! what is beyond shows the sky. E comes from the finished lightmap; a surface without a place in it is shown
//! under the mean irradiance of the scene, as under a light probe. Radiances in cd/m², linear RGB.

use glam::{DAffine3, DMat3, DVec3, Vec3};
use luxel_scene::{Camera, Cancelled, Progress, Scene};
use luxel_transport::{
    Rgb,
    rays::{OFFSET, Rays},
    sampling::{combine, mix, r2, unit2},
};
use rayon::prelude::*;

/// Longest side of the picture in pixels.
const SIDE: u32 = 960;
/// Side of the square of samples in a pixel.
const SUPERSAMPLE: u32 = 2;
/// Surfaces along one ray at most.
const MAX_SURFACES: u32 = 64;
/// Rays of a candidate view, across and down.
const PROBE: [u32; 2] = [24, 16];

/// Irradiance [lux] at a point of an instance's triangle, barycentric (1−u−v, u, v); None without a lightmap there.
pub type Irradiance<'a> = dyn Fn(u32, u32, f32, f32) -> Option<Rgb> + Sync + 'a;

/// A picture of radiances, row-major from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    pub width: u32,
    pub height: u32,
    pub radiance: Vec<Rgb>,
}

/// What is seen, and by whom.
pub struct Preview<'a> {
    pub rays: &'a Rays<'a>,
    pub irradiance: &'a Irradiance<'a>,
    /// Shown on surfaces without a lightmap [lux].
    pub mean: Rgb,
    /// Factors on what materials emit, and on the sky.
    pub emission: &'a [Rgb],
    pub sky: Rgb,
}

impl Preview<'_> {
    /// Renders from the scene's first camera, or from a view that shows much of the lit scene.
    pub fn render(&self, progress: &dyn Progress) -> Result<Picture, Cancelled> {
        let scene = self.rays.geometry.scene;
        let camera = match scene.cameras.first() {
            Some(camera) => camera.clone(),
            None => self.choose(progress)?,
        };
        let (width, height) = size(&camera);
        progress.begin("preview", u64::from(height));
        let lens = Lens::new(&camera, self.rays, f64::from(width) / f64::from(height));
        let mut picture = Picture { width, height, radiance: vec![Rgb::ZERO; width as usize * height as usize] };
        (0..height).into_par_iter().zip(picture.radiance.par_chunks_mut(width as usize)).try_for_each(|(y, row)| {
            progress.check()?;
            (0..width).zip(row).for_each(|(x, pixel)| *pixel = self.pixel(&lens, x, y, width, height));
            progress.advance(1);
            Ok(())
        })?;
        Ok(picture)
    }

    fn pixel(&self, lens: &Lens, x: u32, y: u32, width: u32, height: u32) -> Rgb {
        let cells = SUPERSAMPLE * SUPERSAMPLE;
        // One shift per pixel keeps the stratified pattern and hides its grid.
        let jitter = unit2(mix(u64::from(y) << 32 | u64::from(x)));
        let sum: Rgb = (0..cells)
            .map(|i| {
                let cell = glam::Vec2::new((i % SUPERSAMPLE) as f32, (i / SUPERSAMPLE) as f32);
                let p = (cell + jitter) / SUPERSAMPLE as f32;
                let s = (x as f32 + p.x) / width as f32 * 2.0 - 1.0;
                let t = 1.0 - (y as f32 + p.y) / height as f32 * 2.0;
                self.radiance(lens.eye, lens.direction(s, t)).0
            })
            .sum();
        sum / cells as f32
    }

    /// Radiance along a ray, and the first visible surface: its distance in frame units and its normal.
    fn radiance(&self, eye: Vec3, direction: Vec3) -> (Rgb, Option<(f32, Vec3)>) {
        let geometry = self.rays.geometry;
        let (mut origin, mut travelled) = (eye, 0.0);
        let (mut light, mut pass) = (Rgb::ZERO, Rgb::ONE);
        let mut first = None;
        for _ in 0..MAX_SURFACES {
            let Some(hit) = self.rays.closest(origin, direction, f32::INFINITY) else {
                return (light + pass * self.sky * geometry.scene.sky.radiance(direction), first);
            };
            travelled += hit.distance;
            if !hit.back || geometry.material(hit.triangle).double_sided {
                let surface = geometry.surface(hit.triangle, hit.u, hit.v, 0.0);
                let triangle = &geometry.triangles[hit.triangle as usize];
                first.get_or_insert((travelled, triangle.normal));
                let e = (self.irradiance)(triangle.instance, triangle.index, hit.u, hit.v).unwrap_or(self.mean);
                let mesh = geometry.scene.instances[triangle.instance as usize].mesh;
                let emission = surface.emission * self.emission[geometry.scene.meshes[mesh].material];
                let leaving = emission + surface.albedo * e / std::f32::consts::PI;
                light += pass * surface.coverage * leaving;
                pass *= surface.transmittance;
                if pass.max_element() < 1e-3 {
                    break;
                }
            }
            // Past the surface, by more than the rounding of a point so far away.
            let step = OFFSET.max(travelled * 1e-6);
            travelled += step;
            origin = eye + direction * travelled;
        }
        (light, first)
    }

    /// The candidate view that shows most of the scene lit, not too close and with some depth. The same scene gives
    /// the same view.
    fn choose(&self, progress: &dyn Progress) -> Result<Camera, Cancelled> {
        let candidates = candidates(self.rays);
        progress.begin("view", candidates.len() as u64);
        let scores: Vec<f64> = candidates
            .par_iter()
            .map(|camera| {
                progress.check()?;
                let score = self.score(camera);
                progress.advance(1);
                Ok(score)
            })
            .collect::<Result<_, Cancelled>>()?;
        // The first of equals, so that the choice is stable.
        let mut best = 0;
        for (i, score) in scores.iter().enumerate() {
            if *score > scores[best] {
                best = i;
            }
        }
        Ok(candidates[best].clone())
    }

    fn score(&self, camera: &Camera) -> f64 {
        let lens = Lens::new(camera, self.rays, 1.5);
        let reach = f64::from(luxel_transport::frame::SIDE as f32);
        let typical = f64::from(self.mean.max_element()).max(f64::MIN_POSITIVE) / 8.0;
        let [across, down] = PROBE;
        let mut seen = 0.0;
        let mut depths = Vec::new();
        let mut normals = DVec3::ZERO;
        for i in 0..across * down {
            let s = ((i % across) as f32 + 0.5) / across as f32 * 2.0 - 1.0;
            let t = 1.0 - ((i / across) as f32 + 0.5) / down as f32 * 2.0;
            let (light, Some((distance, normal))) = self.radiance(lens.eye, lens.direction(s, t)) else { continue };
            let bright = f64::from(light.max_element());
            // A wall right before the eye counts little, a lit surface more than a dark one.
            let room = (f64::from(distance) / (0.1 * reach)).min(1.0);
            seen += room * (0.25 + 0.75 * bright / (bright + typical));
            depths.push(f64::from(distance) / reach);
            normals += normal.as_dvec3();
        }
        let n = depths.len() as f64;
        if n == 0.0 {
            return 0.0;
        }
        let mean = depths.iter().sum::<f64>() / n;
        let spread = (depths.iter().map(|d| (d - mean) * (d - mean)).sum::<f64>() / n).sqrt();
        // 0 before a single wall, ½ before two at a right angle.
        let variety = 1.0 - (normals / n).length_squared();
        seen / f64::from(across * down) * (0.25 + spread.min(0.25) + variety)
    }
}

impl Picture {
    /// What a scene without any light looks like.
    pub fn black(scene: &Scene) -> Self {
        let (width, height) = scene.cameras.first().map_or((SIDE, SIDE * 2 / 3), size);
        Self { width, height, radiance: vec![Rgb::ZERO; width as usize * height as usize] }
    }
}

/// Width and height of a camera's picture in pixels.
fn size(camera: &Camera) -> (u32, u32) {
    let aspect = camera.aspect.filter(|a| (0.1..=10.0).contains(a)).unwrap_or(1.5);
    let side = f64::from(SIDE);
    if aspect >= 1.0 { (SIDE, (side / aspect).round() as u32) } else { ((side * aspect).round() as u32, SIDE) }
}

/// A pinhole in frame space.
struct Lens {
    eye: Vec3,
    right: Vec3,
    up: Vec3,
    ahead: Vec3,
}

impl Lens {
    fn new(camera: &Camera, rays: &Rays, aspect: f64) -> Self {
        let m = camera.transform.matrix3;
        let unit = |v: DVec3| v.try_normalize().unwrap_or(DVec3::Y);
        let half = (0.5 * camera.yfov).clamp(1e-3, 1.55);
        let tan = libm::tan(half);
        Self {
            eye: rays.geometry.frame.point(camera.transform.translation),
            right: (unit(m.x_axis) * tan * aspect).as_vec3(),
            up: (unit(m.y_axis) * tan).as_vec3(),
            ahead: (-unit(m.z_axis)).as_vec3(),
        }
    }

    /// Unit direction through (s, t) in [−1, 1]², t upwards.
    fn direction(&self, s: f32, t: f32) -> Vec3 {
        (self.ahead + self.right * s + self.up * t).normalize()
    }
}

/// Views from outside that show all of the scene's box, and views from points within it.
fn candidates(rays: &Rays) -> Vec<Camera> {
    const OUTSIDE: u32 = 8;
    const INSIDE: u32 = 96;
    let Some((lo, hi)) = rays.geometry.scene.bounds() else { return vec![camera(DVec3::ZERO, DVec3::NEG_Z, 0.9)] };
    let (center, size) = (0.5 * (lo + hi), hi - lo);
    let radius = (0.5 * size.length()).max(f64::MIN_POSITIVE);
    let mut list = Vec::new();
    for i in 0..OUTSIDE {
        let azimuth = std::f64::consts::TAU * (f64::from(i) + 0.4) / f64::from(OUTSIDE);
        let (sin, cos) = (libm::sin(azimuth), libm::cos(azimuth));
        let from = DVec3::new(0.87 * cos, 0.5, 0.87 * sin).normalize();
        // The bounding sphere fits a field of view of 0.7 rad.
        list.push(camera(center + from * radius / libm::sin(0.35), -from, 0.7));
    }
    for i in 0..INSIDE {
        let p = r2(i, glam::Vec2::ZERO);
        let q = unit2(combine(7, u64::from(i)));
        let share = DVec3::new(0.1 + 0.8 * f64::from(p.x), 0.3 + 0.4 * f64::from(q.x), 0.1 + 0.8 * f64::from(p.y));
        let azimuth = std::f64::consts::TAU * f64::from(q.y);
        let ahead = DVec3::new(libm::cos(azimuth), -0.12, libm::sin(azimuth)).normalize();
        list.push(camera(lo + size * share, ahead, 1.15));
    }
    list
}

fn camera(eye: DVec3, ahead: DVec3, yfov: f64) -> Camera {
    let right = ahead.cross(DVec3::Y).try_normalize().unwrap_or(DVec3::X);
    let rotation = DMat3::from_cols(right, right.cross(ahead), -ahead);
    Camera { name: "chosen".into(), transform: DAffine3::from_mat3_translation(rotation, eye), yfov, aspect: None }
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel_scene::{Alpha, Material, Silent, Sky, build::Builder};
    use luxel_transport::geometry::Geometry;

    fn render(scene: &luxel_scene::Scene, irradiance: &Irradiance) -> Picture {
        let geometry = Geometry::new(scene);
        let rays = Rays::new(&geometry);
        let emission = vec![Rgb::ONE; rays.geometry.scene.materials.len()];
        Preview { rays: &rays, irradiance, mean: Rgb::ONE, emission: &emission, sky: Rgb::ONE }.render(&Silent).unwrap()
    }

    fn looking_at_a_wall(material: Material) -> luxel_scene::Scene {
        let mut b = Builder::new("wall");
        let m = b.material(material);
        b.quad("wall", Vec3::new(-5.0, -5.0, -2.0), Vec3::X * 10.0, Vec3::Y * 10.0, m);
        b.scene_mut().cameras.push(camera(DVec3::ZERO, DVec3::NEG_Z, 0.8));
        b.scene_mut().sky = Sky::Constant(Vec3::splat(0.25));
        b.build()
    }

    fn grey(albedo: f32) -> Material {
        Material { base_color: Vec3::splat(albedo).extend(1.0), ..Material::default() }
    }

    #[test]
    fn a_lit_wall_shows_its_radiance() {
        let mut material = grey(0.5);
        material.emission = Vec3::splat(0.1);
        let picture = render(&looking_at_a_wall(material), &|_, _, _, _| Some(Rgb::splat(std::f32::consts::PI)));
        assert_eq!((picture.width, picture.height), (960, 640));
        for p in &picture.radiance {
            assert!((*p - Rgb::splat(0.6)).abs().max_element() < 1e-5, "{p}");
        }
    }

    #[test]
    fn a_back_is_culled_and_a_veil_is_seen_through() {
        let mut scene = looking_at_a_wall(grey(0.5));
        scene.instances[0].transform = DAffine3::from_translation(DVec3::Z * 4.0);
        let lit = |_, _, _, _| Some(Rgb::splat(std::f32::consts::PI));
        // The wall now lies behind the camera: only sky is left.
        assert!(render(&scene, &lit).radiance.iter().all(|p| *p == Rgb::splat(0.25)));
        // A veil of coverage ½: half its own light, and the sky through 1−α tinted by the albedo's half.
        let mut veil = grey(1.0);
        veil.base_color.w = 0.5;
        veil.alpha = Alpha::Blend;
        let picture = render(&looking_at_a_wall(veil), &lit);
        let expected = 0.5 * luxel_scene::material::MAX_ALBEDO + 0.25 * 0.5;
        assert!((picture.radiance[0].x - expected).abs() < 1e-4, "{}", picture.radiance[0]);
    }

    #[test]
    fn a_room_without_a_camera_is_seen_from_a_place_that_shows_it() {
        let mut b = Builder::new("room");
        let white = b.matte(Vec3::splat(0.8));
        b.cuboid("shell", Vec3::ZERO, Vec3::new(4.0, 2.0, 3.0), white, true);
        let scene = b.build();
        let lit = |_, _, _, _| Some(Rgb::ONE);
        let picture = render(&scene, &lit);
        assert_eq!(picture, render(&scene, &lit));
        let shown = picture.radiance.iter().filter(|p| p.x > 0.0).count();
        assert!(shown * 3 > picture.radiance.len(), "{shown} of {} pixels show the room", picture.radiance.len());
    }

    #[test]
    fn an_empty_scene_is_a_picture_of_nothing() {
        let picture = render(&luxel_scene::Scene::default(), &|_, _, _, _| None);
        assert!(picture.radiance.iter().all(|p| *p == Rgb::ZERO));
    }
}
