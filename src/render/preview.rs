//! A picture of the scene as an engine would show it with its lightmap, so that one look tells whether a bake is right:
//! from its first camera, or from a view that shows much of the lit scene.

use luxel_scene::{Cancelled, Progress, Scene};

use super::choose::choose;
use super::exposure::estimate;
use super::film::{FIRST, Picture, glimpse};
use super::lens::{Lens, Size, camera};
use super::light::ByLightmap;
use super::march::Look;
use super::pixel::Screen;

/// Takes the picture. Every pixel has the samples that one starts with and no more, for it is taken after every edit.
///
/// # Errors
/// When it is no longer wanted.
pub fn preview(look: &Look, light: &ByLightmap, progress: &dyn Progress) -> Result<Picture, Cancelled> {
    let geometry = look.rays.geometry;
    let camera = match geometry.scene.cameras.first() {
        Some(camera) => camera.clone(),
        None => choose(look, light, light.mean.max_element(), progress)?,
    };
    let (width, height) = Size::usual(&camera);
    progress.begin("preview", u64::from(width) * u64::from(height));
    let lens = Lens::new(&camera, &geometry.frame, f64::from(width) / f64::from(height));
    let screen = Screen { look, lens: &lens, width, height, samples: FIRST, pass: 0 };
    let tone = estimate(&screen, light, progress)?;
    glimpse(&screen, light, &tone, progress)
}

/// What a scene without any light looks like.
pub fn black(scene: &Scene) -> Picture {
    let nobody = camera(glam::DVec3::ZERO, glam::DVec3::NEG_Z, 1.0);
    let (width, height) = Size::usual(scene.cameras.first().unwrap_or(&nobody));
    Picture::black(width, height)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DAffine3, DVec3, Vec3};
    use luxel_scene::{Alpha, Material, Silent, Sky, build::Builder};
    use luxel_transport::{Rgb, geometry::Geometry, rays::Rays};

    use crate::render::light::Lookup;

    fn render(scene: &Scene, lookup: &Lookup) -> Picture {
        let geometry = Geometry::new(scene);
        let rays = Rays::new(&geometry);
        let light = ByLightmap { geometry: &geometry, lookup, mean: Rgb::ONE };
        preview(&Look { rays: &rays, emission: None, sky: Rgb::ONE }, &light, &Silent).unwrap()
    }

    fn looking_at_a_wall(material: Material) -> Scene {
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
        let picture = render(&Scene::default(), &|_, _, _, _| None);
        assert!(picture.radiance.iter().all(|p| *p == Rgb::ZERO));
    }
}
