//! Scenes whose light is known.

use super::*;

/// All methods at receivers in a furnace, whose light is known; `albedo` is the share of it that was reflected.
fn check(world: &World, receivers: &[Receiver], expected: &[f64], albedo: f64, name: &str) {
    let (straight, scale) = (world.straight, expected.iter().sum::<f64>() / expected.len() as f64);
    let error = |l: &Light, e: &f64| (mean(l.total()) - e) / scale;
    // Path tracing: the chi-squared of its own errors, and the mean.
    let tracer = Reference::new(world.rays, Options::default());
    let found = light(&PathTracing::new(&tracer, 2048), receivers);
    let sigma = |l: &Light| f64::from(l.error.unwrap()) / scale + 1e-4;
    let (bias, _) = moments(found.iter().zip(expected).map(|(l, e)| error(l, e)));
    let beyond = found.iter().zip(expected).filter(|(l, e)| error(l, e).abs() > 3.0 * sigma(l)).count();
    println!("{name}: path tracing {:+.3} %, {beyond} beyond 3 sigma", 100.0 * bias);
    // Student's t with 31 degrees of freedom exceeds 3 once in 190.
    assert!(beyond <= 1 + receivers.len() / 60, "{name}: {beyond}");
    let (_, noise) = moments(found.iter().map(sigma));
    assert!(bias.abs() < 3.0 * noise / (receivers.len() as f64).sqrt(), "{name}: path tracing {bias}");
    // Voxels, as they are and by lightcuts.
    let cuts = Lightcuts::new(world.field, lightcuts::Settings::default());
    let methods: [(&str, &dyn Method); 2] =
        [("cached", &Cached::new(world.field)), ("lightcuts", &Reconstruction { straight, reflected: &cuts })];
    for (which, method) in methods {
        let (bias, rms) = moments(light(method, receivers).iter().zip(expected).map(|(l, e)| error(l, e)));
        println!("{name}: {which} {:+.3} %, rms {:.3} %", 100.0 * bias, 100.0 * rms);
        // An even field stays even, whatever the weights with which a method takes means of it.
        assert!(bias.abs() < 1e-4 && rms < 1e-4, "{name}: {which} {bias} {rms}");
    }
    // Random voxels: patches as points make an edge brighter (lightcuts have a control variate for that).
    let samples = VoxelSamples::new(world.field, 4);
    let draws: Vec<Vec<Light>> = (0..REPEATS).map(|k| sampled(world, &samples, k, receivers)).collect();
    let (bias, sigma) = of_repeats(expected, |k| draws[k as usize].clone());
    println!("{name}: random voxels {:+.3} % ± {:.3} %", 100.0 * bias, 100.0 * sigma);
    assert!(bias.abs() < SIGMAS * sigma + PATCHES * albedo, "{name}: random voxels {bias} ± {sigma}");
    // What a receiver states is how far its repeats are apart.
    let spread = |i: usize| {
        let (middle, _) = moments(draws.iter().map(|lights| mean(lights[i].total())));
        let square = draws.iter().map(|lights| (mean(lights[i].total()) - middle).powi(2)).sum::<f64>();
        (square / (REPEATS as f64 - 1.0)).sqrt()
    };
    let (_, spread) = moments((0..receivers.len()).map(spread));
    let (_, stated) = moments(draws.iter().flatten().map(|l| f64::from(l.error.unwrap())));
    println!("{name}: random voxels state {:.3} times their spread", stated / spread);
    assert!((0.8..1.25).contains(&(stated / spread)), "{name}: {stated} {spread}");
    // Photon maps: half a per cent of bias for the density that near rays see.
    let (bias, sigma) = of_repeats(expected, |seed| mapped(world, 5_000, seed, receivers));
    println!("{name}: photon map {:+.3} % ± {:.3} %", 100.0 * bias, 100.0 * sigma);
    assert!(bias.abs() < SIGMAS * sigma + 0.005, "{name}: photon map {bias} ± {sigma}");
}

/// What patches as points add to the reflected light of a furnace with 24 voxels along its longest side, as a share of it.
const PATCHES: f64 = 0.006;

/// What patches as points do to light is in proportion to the edge of a voxel: so is the share of receivers beside an edge.
#[test]
fn patches_as_points_are_an_error_of_first_order() {
    let mut b = Builder::new("furnace");
    let hot = b.emitter(Vec3::splat(0.5), Vec3::ONE);
    b.cuboid("box", Vec3::ZERO, Vec3::new(1.0, 0.8, 0.6), hot, true);
    let scene = b.build();
    let bias = |side: u32| {
        let mut found = (0.0, 0.0);
        with(&scene, side, |world| {
            let receivers = receivers(world.geometry, 600);
            let expected = vec![f64::from(2.0 * PI); receivers.len()];
            let samples = VoxelSamples::new(world.field, 1);
            let (bias, sigma) = of_repeats(&expected, |k| sampled(world, &samples, k, &receivers));
            // Half of the light was reflected.
            found = (2.0 * bias, 2.0 * sigma);
        });
        println!("random voxels, {side} a side: {:+.3} % ± {:.3} %", 100.0 * found.0, 100.0 * found.1);
        found
    };
    let [coarse, middle, fine] = [12, 24, 48].map(bias);
    for ((bias, sigma), most) in [(coarse, 2.0 * PATCHES), (middle, PATCHES), (fine, 0.5 * PATCHES)] {
        assert!(bias.abs() < SIGMAS * sigma + most, "{bias} ± {sigma}, at most {most}");
    }
}

/// A closed furnace: E = πL/(1 − ρ) everywhere.
#[test]
fn a_furnace_is_known_to_every_method() {
    for albedo in [0.5f32, 0.8] {
        let mut b = Builder::new("furnace");
        let hot = b.emitter(Vec3::splat(albedo), Vec3::new(0.5, 1.0, 1.5));
        b.cuboid("box", Vec3::ZERO, Vec3::new(1.0, 0.8, 0.6), hot, true);
        with(&b.build(), 24, |world| {
            let receivers = receivers(world.geometry, 60);
            let expected = f64::from(PI / (1.0 - albedo));
            check(world, &receivers, &vec![expected; receivers.len()], albedo.into(), &format!("furnace {albedo}"));
        });
    }
}

/// Inside a sphere every patch sees every other by dA/4πR²: a cap that sends out Φ lights all of it by Φ/A, and
/// reflections bring ρ/(1 − ρ) times that, evenly.
#[test]
fn a_sphere_with_a_shining_cap_is_evenly_lit() {
    let albedo = 0.6f32;
    let mut b = Builder::new("sphere");
    let grey = b.matte(Vec3::splat(albedo));
    let hot = b.emitter(Vec3::splat(albedo), Vec3::ONE);
    b.sphere("bowl", Vec3::ZERO, 1.0, 24, grey, true);
    let mut cap = b.scene_mut().meshes[0].clone();
    let in_cap = |positions: &[Vec3], t: &[u32; 3]| t.iter().all(|&i| positions[i as usize].y > 0.85);
    let positions = cap.positions.clone();
    cap.triangles.retain(|t| in_cap(&positions, t));
    b.scene_mut().meshes[0].triangles.retain(|t| !in_cap(&positions, t));
    (cap.material, cap.name) = (hot, "cap".into());
    b.add(cap);
    with(&b.build(), 32, |world| {
        let area = |instance: u32| {
            let own = world.geometry.triangles.iter().filter(|t| t.instance == instance);
            own.map(|t| f64::from(t.area())).sum::<f64>()
        };
        let (bowl, cap) = (area(0), area(1));
        let lit = f64::from(PI) * cap / (bowl + cap);
        let receivers = receivers(world.geometry, 60);
        // Facets are tangent at their middles only: the corners of 24 rings see their own less than the law says.
        let expected = vec![lit / f64::from(1.0 - albedo); receivers.len()];
        let reflected = lit * f64::from(albedo / (1.0 - albedo));
        let tracer = Reference::new(world.rays, Options::default());
        let walked = light(&PathTracing::new(&tracer, 4096), &receivers);
        let (bias, _) = moments(walked.iter().map(|l| mean(l.total()) / expected[0] - 1.0));
        let sigma = noise(&walked) / (walked.len() as f64).sqrt();
        // Between their middles and their edges facets are so much nearer to the centre: 1 - cos(π/48).
        let facets = 0.0022;
        println!("sphere: path tracing {:+.3} % ± {:.3} %", 100.0 * bias, 100.0 * sigma);
        assert!(bias.abs() < SIGMAS * sigma + facets, "path tracing {bias} ± {sigma}");
        let cuts = Lightcuts::new(world.field, lightcuts::Settings::default());
        let straight = world.straight;
        let methods: [(&str, &dyn Method); 2] =
            [("cached", &Cached::new(world.field)), ("lightcuts", &Reconstruction { straight, reflected: &cuts })];
        for (name, method) in methods {
            let found = light(method, &receivers);
            let (bias, rms) = moments(found.iter().map(|l| mean(l.indirect) / reflected - 1.0));
            println!("sphere: {name} reflected {:+.2} %, rms {:.2} %", 100.0 * bias, 100.0 * rms);
            assert!(bias.abs() < 0.015 && rms < 0.06, "{name}: {bias} {rms}");
        }
        // Voxels leave what they leave of lightcuts.
        let samples = VoxelSamples::new(world.field, 4);
        let (bias, sigma) = of_repeats(&expected, |k| sampled(world, &samples, k, &receivers));
        println!("sphere: random voxels {:+.3} % ± {:.3} %", 100.0 * bias, 100.0 * sigma);
        assert!(bias.abs() < SIGMAS * sigma + 0.015, "random voxels {bias} ± {sigma}");
        let (bias, sigma) = of_repeats(&expected, |seed| mapped(world, 5_000, seed, &receivers));
        println!("sphere: photon map {:+.3} % ± {:.3} %", 100.0 * bias, 100.0 * sigma);
        assert!(bias.abs() < SIGMAS * sigma + 0.005 + facets, "photon map {bias} ± {sigma}");
    });
}

/// A black floor: nothing is reflected, and what comes straight follows its law.
fn black_floor(shine: impl FnOnce(&mut Builder), law: impl Fn(DVec3) -> f64) {
    let mut b = Builder::new("floor");
    let black = b.matte(Vec3::ZERO);
    b.quad("floor", Vec3::new(-1.0, 0.0, 1.0), Vec3::X * 2.0, Vec3::Z * -2.0, black);
    shine(&mut b);
    let scene = b.build();
    let side = 48;
    with(&scene, side, |world| {
        let floor = |i: u32| {
            let (u, v) = sampling::triangle(sampling::r2(i, Vec2::splat(0.2)));
            Receiver::on_triangle(world.geometry, i % 2, u, v, 1.0, u64::from(i))
        };
        let receivers: Vec<Receiver> = (0..40).map(floor).collect();
        let expected: Vec<f64> = receivers.iter().map(|r| law(world.geometry.frame.world(r.position))).collect();
        let scale = expected.iter().sum::<f64>() / 40.0;
        let map =
            PhotonMap::new(world.rays, world.emitters, photon_map::Settings { photons: 2000, ..Default::default() });
        let samples = VoxelSamples::new(world.field, 1);
        let cuts = Lightcuts::new(world.field, lightcuts::Settings::default());
        let tracer = Reference::new(world.rays, Options::default());
        let straight = world.straight;
        // A surfel has the mean of points in its voxel: what they differ from a receiver there by.
        let span = |e: f64, r: &Receiver| {
            let steps = || (-4..=4).map(|i| f64::from(i) / 4.0 * 2.0 / f64::from(side));
            let place = world.geometry.frame.world(r.position);
            let around = steps().flat_map(|x| steps().map(move |z| DVec3::new(x, 0.0, z)));
            around.map(|d| (law(place + d) - e).abs()).fold(0.0, f64::max)
        };
        let methods: [(&str, &dyn Method, f64); 5] = [
            ("path tracing", &PathTracing::new(&tracer, 1 << 12), 0.0),
            ("cached", &Cached::new(world.field), 0.005),
            ("lightcuts", &Reconstruction { straight, reflected: &cuts }, 0.005),
            ("random voxels", &RandomVoxels { straight, samples: &samples }, 0.005),
            ("photon map", &Reconstruction { straight, reflected: &map }, 0.005),
        ];
        for (name, method, most) in methods {
            for ((l, e), r) in light(method, &receivers).iter().zip(&expected).zip(&receivers) {
                let off = (mean(l.total()) - e) / scale;
                // What states an error is held to it: one in 10 000 exceeds 4.5 of them.
                let noise = if most > 0.0 { 0.0 } else { 4.5 * f64::from(l.error.unwrap()) / scale + 1e-4 };
                let within = if name == "cached" { span(*e, r) / scale } else { 0.0 };
                assert!(off.abs() < most + noise + within, "{name}: {l:?} expected {e}");
                assert!(scene.sky.is_dark() <= (l.indirect == Rgb::ZERO), "{name}: nothing reflects: {l:?}");
            }
        }
    });
}

#[test]
fn a_panel_over_a_floor_is_lamberts() {
    let corners =
        [Vec3::new(-0.4, 0.6, -0.3), Vec3::new(0.4, 0.6, -0.3), Vec3::new(0.4, 0.6, 0.3), Vec3::new(-0.4, 0.6, 0.3)];
    let law = |p: DVec3| {
        let d = corners.map(|c| (c.as_dvec3() - p).normalize());
        let edge = |i: usize| {
            let (a, b) = (d[i], d[(i + 1) % 4]);
            a.cross(b).normalize().y * libm::acos(a.dot(b))
        };
        10.0 * 0.5 * (0..4).map(edge).sum::<f64>().abs()
    };
    let shine = |b: &mut Builder| {
        let hot = b.emitter(Vec3::ZERO, Vec3::splat(10.0));
        b.quad("panel", corners[0], Vec3::X * 0.8, Vec3::Z * 0.6, hot);
    };
    black_floor(shine, law);
}

#[test]
fn a_lamp_over_a_floor_follows_the_inverse_square() {
    let position = DVec3::new(0.2, 0.7, -0.1);
    let law = |p: DVec3| {
        let d = position - p;
        5.0 * d.y / (d.length_squared() * d.length())
    };
    let kind = LightKind::Point { position, range: None, radius: 0.0 };
    black_floor(|b| b.light("lamp", kind, Vec3::splat(5.0)), law);
}

#[test]
fn an_even_sky_over_a_floor_is_pi_times_its_radiance() {
    let sky = |b: &mut Builder| b.scene_mut().sky = Sky::Constant(Vec3::new(1.0, 2.0, 3.0));
    black_floor(sky, |_| f64::from(2.0 * PI));
}
