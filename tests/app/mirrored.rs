//! Textures and shadows as a mirror shows them.

use crate::{
    pictures::{apps_of_both, linear_app, reflect, warm_up},
    stage::{GREEN, RED, SIZE, add, behind, edit_material, settings_of, spawn_mesh, spawn_mirror, wall},
};
use bevy::{
    asset::RenderAssetUsages,
    image::{Image, ImageAddressMode, ImageFilterMode, ImageSampler, ImageSamplerDescriptor},
    math::Affine2,
    prelude::*,
    render::render_resource::{Extent3d, TextureDimension, TextureFormat},
};
use bevy_glint::{RayTracedReflections, ReflectionTechnique, ReflectionTextureMip};
use glint_scenes::{HeadlessApp, Output, SceneName};

/// Red at full size, green in all smaller levels.
fn leveled_image() -> Image {
    const EDGE: u32 = 64;
    let levels = EDGE.ilog2() + 1;
    let texels = |level: u32| {
        let [r, g, b] = if level == 0 { RED } else { GREEN };
        [r, g, b, 255].repeat((EDGE >> level).pow(2) as usize)
    };
    let size = Extent3d {
        width: EDGE,
        height: EDGE,
        ..default()
    };
    let format = TextureFormat::Rgba8UnormSrgb;
    let mut image = Image::new_uninit(size, TextureDimension::D2, format, RenderAssetUsages::default());
    image.texture_descriptor.mip_level_count = levels;
    image.data = Some((0..levels).flat_map(texels).collect());
    image.sampler = ImageSampler::Descriptor(ImageSamplerDescriptor {
        address_mode_u: ImageAddressMode::Repeat,
        address_mode_v: ImageAddressMode::Repeat,
        mipmap_filter: ImageFilterMode::Linear,
        ..ImageSamplerDescriptor::linear()
    });
    image
}

/// Mean red and green of the image.
fn shown(app: &mut HeadlessApp) -> [f32; 2] {
    warm_up(app);
    app.step(2);
    let image = app.capture().unwrap();
    let mean = |channel: usize| {
        let values = image
            .iter()
            .skip(channel)
            .step_by(4)
            .map(|value| f32::from(*value) / 255.0);
        values.sum::<f32>() / (SIZE.x * SIZE.y) as f32
    };
    [mean(0), mean(1)]
}

#[test]
fn a_mirror_shows_the_level_that_fits_its_distance() {
    for (tracer, mut app) in apps_of_both(SIZE, Output::Picture) {
        let app = &mut app;
        let camera = spawn_mirror(app, 0.0, SceneName::MirrorRoom);
        let image = add(app, leveled_image());
        let material = StandardMaterial {
            base_color_texture: Some(image),
            unlit: true,
            ..default()
        };
        let textured = spawn_mesh(app, Rectangle::new(40.0, 40.0), material, behind(8.0));
        reflect(app, camera, ReflectionTechnique::Reference);
        // Texels are larger than pixels, and then far smaller.
        for (repeats, mip, expected) in [
            (2.0, ReflectionTextureMip::RayCone, RED),
            (64.0, ReflectionTextureMip::RayCone, GREEN),
            (64.0, ReflectionTextureMip::Fixed(0.0), RED),
            (2.0, ReflectionTextureMip::Fixed(3.0), GREEN),
        ] {
            edit_material(app, textured, |material| {
                material.uv_transform = Affine2::from_scale(Vec2::splat(repeats));
            });
            settings_of(app, camera).texture_mip = mip;
            let [red, green] = shown(app);
            println!("{tracer}, {repeats} repeats, {mip:?}: red {red:.3}, green {green:.3}");
            let is_expected = if expected == RED {
                red > 0.9 && green < 0.1
            } else {
                green > 0.9 && red < 0.1
            };
            assert!(
                is_expected,
                "{tracer}, {repeats} repeats, {mip:?}: red {red}, green {green}"
            );
        }
    }
}

#[test]
fn a_mirror_shows_shadows_if_shadow_rays_are_on() {
    let Some(mut app) = linear_app(SIZE) else { return };
    let app = &mut app;
    let camera = spawn_mirror(app, 0.0, SceneName::MirrorRoom);
    // Its back is visible, and shows the light that falls on it.
    let turned = Transform::from_xyz(0.0, 0.0, 8.0);
    let white = StandardMaterial {
        double_sided: true,
        cull_mode: None,
        ..default()
    };
    spawn_mesh(app, wall(), white, turned);
    // Before the right half of the wall, and edge-on.
    let at = Transform::from_xyz(0.0, 0.0, 6.5);
    spawn_mesh(app, Cuboid::new(1.5, 1.5, 0.02), Color::BLACK.into(), at);
    app.world().spawn((
        PointLight {
            intensity: 100_000.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::from_xyz(-2.5, 0.0, 5.5),
    ));
    reflect(app, camera, ReflectionTechnique::Reference);
    let mut light = |shadow_rays: bool| {
        app.world().get_mut::<RayTracedReflections>(camera).unwrap().shadow_rays = shadow_rays;
        warm_up(app);
        app.step(2);
        let pixels = app.capture_linear().unwrap();
        pixels.into_iter().map(|[_, green, ..]| green).collect::<Vec<f32>>()
    };
    let (lit, shadowed) = (light(false), light(true));
    // Highlights on the mirror itself are far brighter.
    let mut sorted = lit.clone();
    sorted.sort_by(f32::total_cmp);
    let usual = sorted[sorted.len() / 2];
    let is_lit = |light: f32| usual > 0.0 && light > 0.3 * usual;
    let pairs = || lit.iter().zip(&shadowed);
    let dark = pairs()
        .filter(|(lit, shadowed)| is_lit(**lit) && **shadowed < 0.01 * **lit)
        .count();
    let same = pairs()
        .filter(|(lit, shadowed)| is_lit(**lit) && (**lit - **shadowed).abs() < 0.01 * **lit)
        .count();
    let all = lit.iter().filter(|light| is_lit(**light)).count();
    println!("{dark} pixels in shadow, {same} as before, of {all}");
    assert!(dark > 50 && same > 500, "{dark} pixels in shadow, {same} as before");
    // Edges are sharp, without pixels in between.
    assert!(all - dark - same <= all / 100, "{dark} and {same} of {all}");
}
