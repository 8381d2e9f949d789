//! Blended and transmissive surfaces in a mirror: rays pass through them stochastically, and the mean equals blending.

use crate::{
    pictures::{apps, apps_of_both, linear_app, reflect, warm_up},
    stage::{
        BLUE, GREEN, RED, SIZE, add, begin_anew, behind, edit_material, image, settings_of, spawn_mesh, spawn_mirror,
        unlit,
    },
};
use bevy::{
    image::{ImageAddressMode, ImageSampler, ImageSamplerDescriptor},
    math::Affine2,
    mesh::UvChannel,
    prelude::*,
    render::render_resource::TextureFormat,
};
use bevy_glint::{ReflectionDenoiser, ReflectionTechnique};
use glint_scenes::{HeadlessApp, Output, SceneName};

/// Mean red and green of the image.
fn shown(app: &mut HeadlessApp) -> [f32; 2] {
    let pixels = app.capture_linear().unwrap();
    let mean = |channel: usize| pixels.iter().map(|pixel| pixel[channel]).sum::<f32>() / pixels.len() as f32;
    [mean(0), mean(1)]
}

/// A red pane before a green wall, both behind the camera, which looks into a mirror. Returns the pane.
fn spawn_pane(app: &mut HeadlessApp) -> (Entity, Entity) {
    let camera = spawn_mirror(app, 0.0, SceneName::MirrorRoom);
    let pane = spawn_mesh(app, Rectangle::new(40.0, 40.0), unlit(RED), behind(6.0));
    spawn_mesh(app, Rectangle::new(80.0, 80.0), unlit(GREEN), behind(9.0));
    (camera, pane)
}

fn set_material(app: &mut HeadlessApp, pane: Entity, alpha: f32, alpha_mode: AlphaMode, specular_transmission: f32) {
    edit_material(app, pane, |material| {
        material.base_color.set_alpha(alpha);
        material.alpha_mode = alpha_mode;
        material.specular_transmission = specular_transmission;
    });
}

#[test]
fn a_pane_in_a_mirror_converges_to_the_mean_of_both_sides() {
    for (tracer, mut app) in apps_of_both(SIZE, Output::Linear) {
        let app = &mut app;
        let (camera, pane) = spawn_pane(app);
        reflect(app, camera, ReflectionTechnique::Converged);
        // Red glass absorbs green light.
        for (alpha, alpha_mode, transmission, expected) in [
            (0.5, AlphaMode::Blend, 0.0, [0.5, 0.5]),
            (0.2, AlphaMode::Blend, 0.0, [0.2, 0.8]),
            (0.8, AlphaMode::Blend, 0.5, [0.4, 0.2]),
            (0.3, AlphaMode::Opaque, 0.75, [0.25, 0.0]),
            (1.0, AlphaMode::Opaque, 1.0, [0.0, 0.0]),
            (0.0, AlphaMode::Blend, 0.0, [0.0, 1.0]),
            (1.0, AlphaMode::Blend, 0.0, [1.0, 0.0]),
            (0.5, AlphaMode::Mask(0.4), 0.0, [1.0, 0.0]),
            (0.5, AlphaMode::Mask(0.6), 0.0, [0.0, 1.0]),
            (0.5, AlphaMode::Opaque, 0.0, [1.0, 0.0]),
        ] {
            set_material(app, pane, alpha, alpha_mode, transmission);
            begin_anew(app, camera);
            app.step(16);
            let [red, green] = shown(app);
            let name = format!("{tracer:?}, {alpha_mode:?}, alpha {alpha}, transmission {transmission}");
            println!("{name}: red {red:.4}, green {green:.4}, expected {expected:?}");
            let off = (red - expected[0]).abs().max((green - expected[1]).abs());
            // The mirror itself reflects a little less than all.
            assert!(off < 0.015, "{name}: red {red}, green {green}, expected {expected:?}");
        }
    }
}

/// Exact mirrors with their own rays show panes without chance, in the first frame and in each pixel.
#[test]
fn panes_in_an_exact_mirror_have_no_grain() {
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        let (camera, pane) = spawn_pane(app);
        let second = spawn_mesh(app, Rectangle::new(60.0, 60.0), unlit(BLUE), behind(7.0));
        reflect(app, camera, ReflectionTechnique::Quarter);
        settings_of(app, camera).full_resolution_mirrors = true;
        // Alpha and transmission of the red pane, and of the blue one.
        for (red, blue, expected) in [
            ((0.5, 0.0), (0.0, 0.0), [0.5, 0.5, 0.0]),
            ((0.5, 0.0), (0.5, 0.0), [0.5, 0.25, 0.25]),
            ((0.2, 0.0), (0.5, 0.5), [0.2, 0.4, 0.2]),
            ((1.0, 0.75), (0.0, 0.0), [0.25, 0.0, 0.0]),
            ((1.0, 0.0), (0.5, 0.0), [1.0, 0.0, 0.0]),
            ((0.0, 0.0), (1.0, 1.0), [0.0, 0.0, 0.0]),
        ] {
            for (pane, (alpha, transmission)) in [(pane, red), (second, blue)] {
                set_material(app, pane, alpha, AlphaMode::Blend, transmission);
            }
            warm_up(app);
            let pixels = app.capture_linear().unwrap();
            let off = |pixel: &[f32; 4]| (0..3).map(|i| (pixel[i] - expected[i]).abs()).fold(0.0, f32::max);
            let farthest = pixels.iter().max_by(|a, b| off(a).total_cmp(&off(b))).unwrap();
            println!("{tracer:?}, red {red:?}, blue {blue:?}: {farthest:?} at most, expected {expected:?}");
            assert!(off(farthest) < 0.02, "{tracer:?}: {farthest:?}, expected {expected:?}");
        }
        // More panes than exact layers: the last ones are stochastic, and the mean still equals blending.
        for pane in [pane, second] {
            app.world().despawn(pane);
        }
        let glass = StandardMaterial {
            base_color: Color::srgba(1.0, 0.0, 0.0, 0.25),
            alpha_mode: AlphaMode::Blend,
            ..unlit(RED)
        };
        for z in 0..6 {
            let place = behind(6.0 + 0.25 * z as f32);
            spawn_mesh(app, Rectangle::new(60.0, 60.0), glass.clone(), place);
        }
        warm_up(app);
        let [red, green] = shown(app);
        let passed = 0.75f32.powi(6);
        println!("{tracer:?}, six panes: red {red:.4}, green {green:.4}, expected {passed:.4} of green");
        assert!(
            (green - passed).abs() < 0.01 && (red - 1.0 + passed).abs() < 0.01,
            "{red}, {green}"
        );
    }
}

fn tinted_glass([red, green, blue]: [f32; 3]) -> StandardMaterial {
    StandardMaterial {
        base_color: Color::linear_rgb(red, green, blue),
        specular_transmission: 1.0,
        ..default()
    }
}

/// Coloured glass tints the surfaces behind it, and nothing in front of it, regardless of the number of panes. All passes do this.
#[test]
fn glass_tints_what_is_seen_through_it() {
    const TINT: [f32; 3] = [0.25, 0.5, 1.0];
    for (tracer, mut app) in apps_of_both(SIZE, Output::Linear) {
        let app = &mut app;
        let camera = spawn_mirror(app, 0.0, SceneName::MirrorRoom);
        spawn_mesh(app, Rectangle::new(80.0, 80.0), unlit([255; 3]), behind(9.0));
        let glass = tinted_glass(TINT);
        for (panes, z) in [(0, 12.0), (1, 6.0), (2, 7.0)] {
            spawn_mesh(app, Rectangle::new(60.0, 60.0), glass.clone(), behind(z));
            use ReflectionTechnique::{Converged, Quarter, QuarterInline, Reference};
            for technique in [Converged, Reference, Quarter, QuarterInline] {
                reflect(app, camera, technique);
                app.step(4);
                let middle = (SIZE.y / 2 * SIZE.x + SIZE.x / 2) as usize;
                let shown = app.capture_linear().unwrap()[middle];
                let expected = TINT.map(|part| part.powi(panes));
                println!("{tracer:?}, {technique:?}, {panes} panes: {shown:?}, expected {expected:?}");
                let off = (0..3).map(|i| (shown[i] - expected[i]).abs()).fold(0.0, f32::max);
                assert!(
                    off < 0.02,
                    "{tracer:?}, {technique:?}, {panes} panes: {shown:?}, expected {expected:?}"
                );
            }
        }
    }
}

/// Its texture tints, too, wherever it lies on the glass.
#[test]
fn glass_tints_by_its_texture() {
    const TINT: [f32; 3] = [0.5, 0.25, 1.0];
    // Halves of the texture.
    const HALVES: [[u8; 4]; 2] = [[255, 0, 255, 255], [0, 255, 0, 255]];
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        let camera = spawn_mirror(app, 0.0, SceneName::MirrorRoom);
        spawn_mesh(app, Rectangle::new(80.0, 80.0), unlit([255; 3]), behind(9.0));
        let texels = (0..64).flat_map(|i| HALVES[i % 8 / 4]).collect();
        let mut image = image(UVec2::splat(8), TextureFormat::Rgba8UnormSrgb, texels);
        image.sampler = ImageSampler::Descriptor(ImageSamplerDescriptor {
            address_mode_u: ImageAddressMode::Repeat,
            ..ImageSamplerDescriptor::linear()
        });
        let texture = add(app, image);
        let plain = tinted_glass(TINT);
        let textured = StandardMaterial {
            base_color_texture: Some(texture),
            ..plain.clone()
        };
        let moved = StandardMaterial {
            uv_transform: Affine2::from_translation(Vec2::new(0.5, 0.0)),
            ..textured.clone()
        };
        let by_second_uvs = StandardMaterial {
            base_color_channel: UvChannel::Uv1,
            ..moved.clone()
        };
        let rectangle = || Mesh::from(Rectangle::new(12.0, 12.0));
        let count = rectangle().count_vertices();
        let second_half = rectangle().with_inserted_attribute(Mesh::ATTRIBUTE_UV_1, vec![[0.75f32, 0.5]; count]);
        let no_uvs = rectangle().with_removed_attribute(Mesh::ATTRIBUTE_UV_0);
        let [first, second] = HALVES.map(|half| [0, 1, 2].map(|i| TINT[i] * f32::from(half[i]) / 255.0));
        // U increases to the left, as seen in the mirror.
        for (name, mesh, material, expected) in [
            ("textured", rectangle(), &textured, [second, first]),
            ("moved", rectangle(), &moved, [first, second]),
            ("second UVs", second_half.clone(), &by_second_uvs, [first, first]),
            ("second UVs, not wanted", second_half, &textured, [second, first]),
            ("second UVs, not there", rectangle(), &by_second_uvs, [first, second]),
            ("without UVs", no_uvs, &textured, [TINT, TINT]),
            ("plain", rectangle(), &plain, [TINT, TINT]),
        ] {
            let pane = spawn_mesh(app, mesh, material.clone(), behind(6.0));
            reflect(app, camera, ReflectionTechnique::Reference);
            app.step(4);
            let pixels = app.capture_linear().unwrap();
            for (column, expected) in [SIZE.x / 4, 3 * SIZE.x / 4].into_iter().zip(expected) {
                let shown = pixels[(SIZE.y / 2 * SIZE.x + column) as usize];
                println!("{tracer:?}, {name}, column {column}: {shown:?}, expected {expected:?}");
                let off = (0..3).map(|i| (shown[i] - expected[i]).abs()).fold(0.0, f32::max);
                assert!(off < 0.02, "{tracer:?}, {name}: {shown:?}, expected {expected:?}");
            }
            app.world().despawn(pane);
        }
    }
}

/// Thick glass displaces the edge of two colours, in rough surfaces, too, and with any tracer.
#[test]
fn thick_glass_refracts_in_rough_reflections() {
    use ReflectionTechnique::{Converged, Quarter, QuarterInline, Reference};
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        let camera = spawn_mirror(app, 0.15, SceneName::MirrorRoom);
        spawn_mesh(app, Rectangle::new(80.0, 80.0), unlit(GREEN), behind(9.0));
        let right = Transform::from_xyz(20.0, 0.0, 0.0) * behind(8.99);
        spawn_mesh(app, Rectangle::new(40.0, 80.0), unlit(RED), right);
        let glass = StandardMaterial {
            ior: 1.5,
            ..tinted_glass([1.0, 0.8, 1.0])
        };
        let at = behind(5.0) * Transform::from_rotation(Quat::from_rotation_y(0.7));
        let pane = spawn_mesh(app, Rectangle::new(60.0, 60.0), glass, at);
        let mut red_by = |technique, thickness| {
            edit_material(app, pane, |material| material.thickness = thickness);
            app.step(2);
            reflect(app, camera, technique);
            let frames = if technique == Converged { 32 } else { 1 };
            app.step(frames);
            let [red, green] = shown(app);
            println!("{tracer:?}, {technique:?}, {thickness} m thick: red {red:.4}, green {green:.4}");
            red
        };
        let (straight, truth) = (red_by(Converged, 0.0), red_by(Converged, 2.0));
        assert!((straight - truth).abs() > 0.04, "{tracer:?}: {straight}, {truth}");
        for technique in [Reference, Quarter, QuarterInline] {
            let refracted = red_by(technique, 2.0);
            assert!(
                (refracted - truth).abs() < 0.2 * (straight - truth).abs(),
                "{tracer:?}, {technique:?}: {refracted}, expected {truth}, straight {straight}"
            );
        }
    }
}

/// The denoiser of a static view converges to the same, pixel by pixel.
#[test]
fn a_static_view_shows_a_pane_as_blended() {
    let Some(mut app) = linear_app(SIZE) else { return };
    let app = &mut app;
    let (camera, pane) = spawn_pane(app);
    set_material(app, pane, 0.5, AlphaMode::Blend, 0.0);
    reflect(app, camera, ReflectionTechnique::Quarter);
    settings_of(app, camera).denoiser = ReflectionDenoiser::default();
    app.step(2);
    warm_up(app);
    app.step(96);
    let [red, green] = shown(app);
    let pixels = app.capture_linear().unwrap();
    let far = pixels.iter().filter(|pixel| (pixel[0] - 0.5).abs() > 0.2).count();
    println!("red {red:.4}, green {green:.4}, {far} pixels far off");
    assert!((red - 0.5).abs() < 0.02 && (green - 0.5).abs() < 0.02, "{red}, {green}");
    assert!(far * 50 < pixels.len(), "{far} pixels are far off");
}
