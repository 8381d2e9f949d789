//! Reflections on glass and water, which are drawn over the opaque image.

use crate::{
    common::app_of,
    pictures::{apps, device_without, reflect, warm_up},
    stage::{
        BEFORE_THE_MIRROR, GREEN, RED, SIZE, add, before, clear_glass, cube_map, edit_material, frame, layer_bytes,
        settings_of, share_picture, sheet, spawn_behind, spawn_camera, spawn_mesh, unlit,
    },
};
use bevy::{
    camera::{Exposure, Viewport},
    image::Image,
    light::LightProbe,
    math::Vec3Swizzles,
    pbr::ScreenSpaceTransmission,
    prelude::*,
    render::settings::{WgpuFeatures, WgpuSettings},
};
use bevy_glint::{NotReflected, RayTracedReflections, ReflectionDenoiser, ReflectionTechnique, ReflectionTracerChoice};
use glint_scenes::{HeadlessApp, HeadlessSettings, Output, SceneName};

const BLACK: [u8; 3] = [0; 3];
/// F0 of 0.04.
const GLASS: f32 = 0.5;
/// F0 of 0.16, which no glass has, but which is easy to see.
const STRONG: f32 = 1.0;

/// Adds its reflection to the surfaces behind it.
fn pane(reflectance: f32, perceptual_roughness: f32) -> StandardMaterial {
    StandardMaterial {
        reflectance,
        perceptual_roughness,
        ..clear_glass()
    }
}

/// Something that the camera sees and no ray.
fn spawn_unreflected(app: &mut HeadlessApp, color: [u8; 3], at: Transform) {
    let object = spawn_mesh(app, sheet(), unlit(color), at);
    app.world().entity_mut(object).insert(NotReflected);
}

/// Linear colour of a pixel, as a part of the picture's size.
fn color_at(app: &HeadlessApp, x: f32, y: f32) -> [f32; 3] {
    let size = app.size();
    let place = (Vec2::new(x, y) * size.as_vec2()).as_uvec2().min(size - 1);
    let [r, g, b, _] = app.capture_linear().unwrap()[(place.y * size.x + place.x) as usize];
    [r, g, b]
}

fn center(app: &HeadlessApp) -> [f32; 3] {
    color_at(app, 0.5, 0.5)
}

fn set_transparent(app: &mut HeadlessApp, camera: Entity, transparent: bool) {
    let mut settings = app.world().get_mut::<RayTracedReflections>(camera).unwrap();
    settings.transparent = transparent;
    settings.reset = true;
    app.step(2);
    warm_up(app);
    app.step(4);
}

/// Pixels that aren't the same bit for bit.
fn differing(a: &[[f32; 4]], b: &[[f32; 4]]) -> usize {
    a.iter().zip(b).filter(|(a, b)| a != b).count()
}

/// Largest difference of a channel, relative to its value.
fn largest_difference(a: &[[f32; 4]], b: &[[f32; 4]]) -> f32 {
    let channels = a.as_flattened().iter().zip(b.as_flattened());
    channels
        .map(|(a, b)| (a - b).abs() / a.abs().max(0.01))
        .fold(0.0, f32::max)
}

/// Schlick's term.
fn fresnel(reflectance: f32, cosine: f32) -> f32 {
    let f0 = 0.16 * reflectance * reflectance;
    f0 + (1.0 - f0) * (1.0 - cosine).powi(5)
}

/// A pane over black, in white surroundings, adds its Fresnel term.
#[test]
fn a_pane_in_a_white_furnace_adds_its_fresnel_term() {
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::Furnace);
        spawn_unreflected(app, BLACK, before(60.0));
        let sheet = spawn_mesh(app, sheet(), pane(GLASS, 0.0), before(3.0));
        use ReflectionTechnique::{Converged, Reference, Variable};
        for (technique, degrees, roughness) in [
            (Reference, 0.0f32, 0.0),
            (Reference, 45.0, 0.0),
            (Reference, 60.0, 0.0),
            (Reference, 75.0, 0.0),
            (Variable, 60.0, 0.0),
            (Variable, 45.0, 0.3),
            (Converged, 60.0, 0.0),
        ] {
            let mut at = before(3.0);
            at.rotate_y(degrees.to_radians());
            app.world().entity_mut(sheet).insert(at);
            set_material(app, sheet, pane(GLASS, roughness));
            reflect(app, camera, technique);
            app.step(8);
            let [added, ..] = center(app);
            let expected = fresnel(GLASS, degrees.to_radians().cos());
            println!(
                "{tracer:?}, {technique:?}, {degrees} degrees, roughness {roughness}: {added:.4}, expected {expected:.4}"
            );
            assert!(
                (added - expected).abs() < 0.01,
                "{tracer:?}, {technique:?}, {degrees} degrees: {added}, expected {expected}"
            );
        }
    }
}

fn set_material(app: &mut HeadlessApp, object: Entity, material: StandardMaterial) {
    edit_material(app, object, |changed| *changed = material);
}

/// Traced light replaces the environment's light: a black wall before a pane darkens it in white surroundings.
#[test]
fn a_pane_shows_what_is_before_it_in_place_of_the_environment() {
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::Furnace);
        spawn_unreflected(app, BLACK, before(60.0));
        spawn_mesh(app, sheet(), pane(STRONG, 0.0), before(3.0));
        spawn_behind(app, BLACK);
        for technique in [ReflectionTechnique::Reference, ReflectionTechnique::Variable] {
            reflect(app, camera, technique);
            app.step(8);
            set_transparent(app, camera, false);
            let [off, ..] = center(app);
            set_transparent(app, camera, true);
            let [on, ..] = center(app);
            println!("{tracer:?}, {technique:?}: {off:.4} without, {on:.4} with");
            assert!(
                (off - 0.16).abs() < 0.01 && on.abs() < 0.002,
                "{tracer:?}: {off} without, {on} with"
            );
        }
    }
}

/// Smoke over glass dims the environment's light on it, so less of that light can be removed.
#[test]
fn no_light_is_negative_where_glass_is_covered() {
    let apart = device_without(WgpuFeatures::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES);
    for (name, device) in [("in place", WgpuSettings::default()), ("blended", apart)] {
        let settings = HeadlessSettings {
            size: SIZE,
            output: Output::Linear,
            device,
            ..default()
        };
        let Some(mut app) = app_of(settings, ReflectionTracerChoice::Bvh, |_| {}, |_| {}) else {
            return;
        };
        let app = &mut app;
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::Furnace);
        spawn_unreflected(app, BLACK, before(10.0));
        spawn_mesh(app, sheet(), pane(STRONG, 0.0), before(3.0));
        spawn_behind(app, BLACK);
        let smoke = StandardMaterial {
            base_color: Color::BLACK.with_alpha(0.75),
            alpha_mode: AlphaMode::Blend,
            ..unlit(BLACK)
        };
        let smoke = spawn_mesh(app, Rectangle::new(1.0, 1.0), smoke, before(2.0));
        app.world().entity_mut(smoke).insert(NotReflected);
        reflect(app, camera, ReflectionTechnique::Reference);
        app.step(8);
        let picture = app.capture_linear().unwrap();
        let channels = picture.iter().flat_map(|pixel| &pixel[..3]);
        let (least, most) = channels.fold((f32::MAX, f32::MIN), |(least, most), &channel| {
            (least.min(channel), most.max(channel))
        });
        println!("{name}: from {least} to {most}");
        assert!(least >= 0.0 && most < 0.002, "{name}: from {least} to {most}");
        // The smoke is there.
        set_transparent(app, camera, false);
        let ([dimmed, ..], [open, ..]) = (center(app), color_at(app, 0.05, 0.05));
        assert!((dimmed / open - 0.25).abs() < 0.02, "{name}: {dimmed}, {open}");
    }
}

/// The part of a red wall that each kind of material shows.
#[test]
fn each_kind_of_material_reflects_as_it_is_blended() {
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
        spawn_unreflected(app, BLACK, before(60.0));
        let sheet = spawn_mesh(app, sheet(), pane(STRONG, 0.0), before(3.0));
        spawn_behind(app, RED);
        reflect(app, camera, ReflectionTechnique::Reference);
        let blend = |alpha: f32| StandardMaterial {
            base_color: Color::BLACK.with_alpha(alpha),
            alpha_mode: AlphaMode::Blend,
            ..pane(STRONG, 0.0)
        };
        let transmissive = StandardMaterial {
            base_color: Color::BLACK,
            alpha_mode: AlphaMode::Opaque,
            specular_transmission: 1.0,
            ..pane(STRONG, 0.0)
        };
        let unlit = StandardMaterial {
            unlit: true,
            ..pane(STRONG, 0.0)
        };
        let added = StandardMaterial {
            alpha_mode: AlphaMode::Add,
            ..pane(STRONG, 0.0)
        };
        let cases = [
            ("premultiplied", pane(STRONG, 0.0), 0.16),
            ("blended", blend(0.5), 0.08),
            ("blended, invisible", blend(0.0), 0.0),
            ("transmissive", transmissive.clone(), 0.16),
            ("transmissive, to cameras that draw none", transmissive, 0.0),
            ("unlit", unlit, 0.0),
            ("added", added, 0.0),
        ];
        for (name, material, expected) in cases {
            set_material(app, sheet, material);
            let mut camera = app.world().entity_mut(camera);
            if name == "transmissive" {
                camera.insert(ScreenSpaceTransmission::default());
            } else {
                camera.remove::<ScreenSpaceTransmission>();
            }
            app.step(4);
            warm_up(app);
            app.step(4);
            let [red, green, _] = center(app);
            println!("{tracer:?}, {name}: {red:.4}, expected {expected}");
            assert!(
                (red - expected).abs() < 0.004 && green.abs() < 1e-3,
                "{tracer:?}, {name}: {red}, {green}"
            );
        }
    }
}

/// The front one of two panes reflects. A pane behind something opaque doesn't.
#[test]
fn the_front_most_surface_reflects() {
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
        spawn_unreflected(app, BLACK, before(60.0));
        let [first, second] = [2.0, 4.0].map(|distance| spawn_mesh(app, sheet(), pane(STRONG, 0.0), before(distance)));
        set_material(app, first, pane(GLASS, 0.0));
        spawn_behind(app, RED);
        reflect(app, camera, ReflectionTechnique::Reference);
        app.step(4);
        let [both, ..] = center(app);
        assert!((both - 0.04).abs() < 0.002, "{tracer:?}: {both}");
        app.world().entity_mut(first).insert(before(6.0));
        app.step(4);
        let [turned, ..] = center(app);
        assert!((turned - 0.16).abs() < 0.004, "{tracer:?}: {turned}");
        app.world().despawn(first);
        spawn_mesh(app, Cuboid::from_length(1.0), unlit(GREEN), before(2.0));
        app.step(2);
        warm_up(app);
        app.step(4);
        let hidden = center(app);
        assert!(hidden[0].abs() < 1e-4 && hidden[1] > 0.99, "{tracer:?}: {hidden:?}");
        let [beside, ..] = color_at(app, 0.05, 0.5);
        assert!((beside - 0.16).abs() < 0.02, "{tracer:?}: {beside}");
        let with = app.capture_linear().unwrap();
        app.world().despawn(second);
        app.step(4);
        let without = app.capture_linear().unwrap();
        let middle = (SIZE.y / 2 * SIZE.x + SIZE.x / 2) as usize;
        assert_eq!(with[middle], without[middle], "{tracer:?}");
    }
}

/// Parallel rays, and parts of an image, with a layer for each camera.
#[test]
fn orthographic_cameras_and_split_screens_have_layers() {
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
        spawn_unreflected(app, BLACK, before(60.0));
        // It covers the left half.
        let aside = |x: f32| before(3.0) * Transform::from_xyz(x, 0.0, 0.0);
        let pane = spawn_mesh(app, sheet(), pane(STRONG, 0.0), aside(-20.0));
        spawn_behind(app, RED);
        reflect(app, camera, ReflectionTechnique::Reference);
        let perspective = app.world().get::<Projection>(camera).unwrap().clone();
        let parallel = Projection::Orthographic(OrthographicProjection {
            scale: 0.05,
            ..OrthographicProjection::default_3d()
        });
        for projection in [parallel, perspective] {
            app.world().entity_mut(camera).insert(projection.clone());
            app.step(4);
            let [[left, ..], [right, ..]] = [0.25, 0.75].map(|x| color_at(app, x, 0.5));
            println!("{tracer:?}: {left:.4} {right:.4}");
            assert!(
                (left - 0.16).abs() < 0.02 && right.abs() < 1e-4,
                "{tracer:?}: {left}, {right}"
            );
        }
        let second = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
        reflect(app, second, ReflectionTechnique::Reference);
        share_picture(app, [camera, second]);
        app.step(4);
        warm_up(app);
        app.step(4);
        let shown = [0.125, 0.375, 0.625, 0.875].map(|x| color_at(app, x, 0.5)[0]);
        println!("{tracer:?}: {shown:?}");
        for (red, expected) in shown.into_iter().zip([0.16, 0.0, 0.16, 0.0]) {
            assert!((red - expected).abs() < 0.02, "{tracer:?}: {shown:?}");
        }
        // A pane that moves away is gone from its old place.
        app.world().entity_mut(pane).insert(aside(20.0));
        app.step(6);
        let shown = [0.125, 0.375, 0.625, 0.875].map(|x| color_at(app, x, 0.5)[0]);
        for (red, expected) in shown.into_iter().zip([0.0, 0.16, 0.0, 0.16]) {
            assert!((red - expected).abs() < 0.02, "{tracer:?}: {shown:?}");
        }
    }
}

/// With reflections off, the image equals the one without reflections bit for bit. While nothing is see-through, no memory is
/// allocated, on or off.
#[test]
fn nothing_see_through_costs_nothing() {
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::Furnace);
        spawn_unreflected(app, BLACK, before(60.0));
        let sheet = spawn_mesh(app, sheet(), pane(STRONG, 0.0), before(3.0));
        spawn_behind(app, RED);
        reflect(app, camera, ReflectionTechnique::Variable);
        app.step(4);
        assert!(layer_bytes(app) > 0, "{tracer:?}");
        let on = app.capture_linear().unwrap();
        set_transparent(app, camera, false);
        assert_eq!(layer_bytes(app), 0, "{tracer:?}");
        let off = app.capture_linear().unwrap();
        app.world().entity_mut(camera).remove::<RayTracedReflections>();
        app.step(4);
        let plain = app.capture_linear().unwrap();
        assert_eq!(differing(&off, &plain), 0, "{tracer:?}");
        assert!(differing(&on, &plain) > on.len() / 2, "{tracer:?}");

        reflect(app, camera, ReflectionTechnique::Variable);
        set_transparent(app, camera, true);
        assert!(layer_bytes(app) > 0, "{tracer:?}");
        // Out of sight.
        app.world().entity_mut(sheet).insert(before(-100.0));
        (0..70).for_each(|_| frame(app));
        assert_eq!(layer_bytes(app), 0, "{tracer:?}");
        app.world().entity_mut(sheet).insert(before(3.0));
        (0..4).for_each(|_| frame(app));
        assert!(layer_bytes(app) > 0, "{tracer:?}");
        // The history of the layer begins anew, which rounds differently on some GPUs.
        let apart = largest_difference(&on, &app.capture_linear().unwrap());
        assert!(apart <= 0.004, "{tracer:?}: {apart}");
        set_material(app, sheet, unlit(BLACK));
        (0..70).for_each(|_| frame(app));
        assert_eq!(layer_bytes(app), 0, "{tracer:?}");
    }
}

/// Rough surfaces have the same denoiser as opaque ones.
#[test]
#[ignore = "long: hundreds of frames"]
fn rough_panes_converge() {
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
        spawn_unreflected(app, BLACK, before(60.0));
        spawn_mesh(app, sheet(), pane(STRONG, 0.4), before(3.0));
        let at = Transform::from_xyz(0.0, 0.0, 4.0);
        spawn_mesh(app, Cuboid::from_length(2.0), unlit(RED), at);
        reflect(app, camera, ReflectionTechnique::Converged);
        app.step(256);
        let red = |app: &HeadlessApp| -> Vec<f32> {
            let pixels = app.capture_linear().unwrap();
            pixels.iter().map(|pixel| pixel[0]).collect()
        };
        let truth = red(app);
        reflect(app, camera, ReflectionTechnique::Variable);
        settings_of(app, camera).denoiser = ReflectionDenoiser::default();
        app.step(4);
        warm_up(app);
        app.step(96);
        let shown = red(app);
        let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
        let apart = truth.iter().zip(&shown).map(|(a, b)| (a - b).abs()).sum::<f32>() / truth.len() as f32;
        println!(
            "{tracer:?}: mean {:.5}, {:.5} shown, apart by {apart:.5}",
            mean(&truth),
            mean(&shown)
        );
        assert!(mean(&truth) > 0.01, "{tracer:?}");
        assert!((mean(&shown) / mean(&truth) - 1.0).abs() < 0.02, "{tracer:?}");
        assert!(apart < 0.1 * mean(&truth), "{tracer:?}: {apart}");
    }
}

/// A cube map with another colour on each face, none of them red.
fn faces(app: &mut HeadlessApp) -> Handle<Image> {
    const COLORS: [[u8; 3]; 6] = [
        [0, 255, 0],
        [0, 0, 255],
        [0, 255, 255],
        [0, 128, 0],
        [0, 0, 128],
        [0, 128, 255],
    ];
    let texels = COLORS.into_iter().flat_map(|[r, g, b]| [r, g, b, 255]).collect();
    add(app, cube_map(1, texels))
}

/// Over black, a pane in a reflection probe adds the light of rays and no light of the probe, anywhere in its box, with and without
/// the camera's map.
#[test]
fn probes_give_way_to_rays() {
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        let surroundings = [SceneName::MirrorRoom, SceneName::Furnace];
        let cameras = surroundings.map(|name| spawn_camera(app, BEFORE_THE_MIRROR, name));
        spawn_unreflected(app, BLACK, before(60.0));
        let sheet = spawn_mesh(app, sheet(), pane(STRONG, 0.0), before(3.0));
        spawn_behind(app, RED);
        let map = faces(app);
        let probe = app.world().spawn((
            LightProbe {
                falloff: Vec3::splat(0.5),
            },
            EnvironmentMapLight {
                diffuse_map: map.clone(),
                specular_map: map,
                intensity: 2000.0,
                rotation: Quat::from_rotation_x(0.4),
                ..default()
            },
        ));
        let probe = probe.id();
        for (camera, name) in cameras.into_iter().zip(surroundings) {
            for other in cameras {
                app.world().entity_mut(other).insert(Exposure::default());
                app.world().get_mut::<Camera>(other).unwrap().is_active = other == camera;
            }
            reflect(app, camera, ReflectionTechnique::Reference);
            // The pane in the middle of the box, and where the probe fades out.
            for (x, degrees, roughness) in [(0.0, 0.0f32, 0.0), (0.5, 30.0, 0.0), (6.5, 0.0, 0.0), (6.5, 30.0, 0.3)] {
                let mut at = before(3.0);
                at.rotate_y(degrees.to_radians());
                app.world().entity_mut(sheet).insert(at);
                set_material(app, sheet, pane(STRONG, roughness));
                let place = Transform::from_xyz(x, 1.0, 0.0).with_scale(Vec3::splat(20.0));
                app.world().entity_mut(probe).insert(place);
                set_transparent(app, camera, false);
                let bevys = Vec3::from(center(app));
                set_transparent(app, camera, true);
                let shown = Vec3::from(center(app));
                println!("{tracer:?}, {name:?}, {x}, {degrees} degrees, {roughness}: {bevys} without, {shown} with");
                assert!(bevys.yz().max_element() > 0.05, "{tracer:?}: {bevys}");
                let expected = fresnel(STRONG, degrees.to_radians().cos());
                assert!(
                    (shown.x - expected).abs() < 0.01 && shown.yz().abs().max_element() < 0.004,
                    "{tracer:?}, {name:?}, {x}, {degrees} degrees, {roughness}: {shown}, expected {expected}"
                );
            }
        }
    }
}

/// A quarter of the image takes a quarter of the memory, except for the normals, which Bevy's prepass shares.
#[test]
fn a_layer_is_as_large_as_its_viewport() {
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::Furnace);
        spawn_mesh(app, sheet(), pane(STRONG, 0.0), before(3.0));
        app.world().get_mut::<Camera>(camera).unwrap().viewport = Some(Viewport {
            physical_position: SIZE / 2,
            physical_size: SIZE / 2,
            ..default()
        });
        reflect(app, camera, ReflectionTechnique::Reference);
        app.step(4);
        let quarter = layer_bytes(app);
        app.world().get_mut::<Camera>(camera).unwrap().viewport = None;
        app.step(4);
        let whole = layer_bytes(app);
        println!("{tracer:?}: {whole} and {quarter} bytes");
        assert!(
            quarter > 0 && 5 * quarter < 2 * whole,
            "{tracer:?}: {quarter} of {whole} bytes"
        );
    }
}
