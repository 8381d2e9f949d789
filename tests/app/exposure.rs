//! Changes of exposure brighten or darken the light that exposure applies to, and leave unlit colours as they are.

use crate::{
    pictures::{linear_app, reflect, warm_up},
    stage::{BEFORE_THE_MIRROR, SIZE, denoised, metal, settings_of, spawn_camera, spawn_mesh, unlit, wall},
    static_views::capture,
};
use bevy::{camera::Exposure, prelude::*};
use bevy_glint::ReflectionTechnique;
use glint_scenes::{HeadlessApp, SceneName};

/// EV100 in which the lit panel is about as bright as the unlit one.
const BRIGHT: f32 = 10.0;
/// Frames until histories have their full length.
const SETTLE: u32 = 36;

/// Mean light of the left half of the image, which reflects an unlit panel, and of the right half, with a sunlit one.
fn halves(app: &mut HeadlessApp) -> [f32; 2] {
    let (pixels, width) = (capture(app), SIZE.x as usize);
    let mean = |columns: core::ops::Range<usize>| {
        let rows = pixels.chunks_exact(width).flat_map(|row| &row[columns.clone()]);
        rows.sum::<f32>() / (columns.len() * SIZE.y as usize) as f32
    };
    [mean(8..width / 2 - 24), mean(width / 2 + 24..width - 8)]
}

fn expose(app: &mut HeadlessApp, camera: Entity, ev100: f32) {
    app.world().entity_mut(camera).insert(Exposure { ev100 });
}

/// Quotient of the light in both halves and the light in a view of the same exposure from the start.
fn apart(app: &mut HeadlessApp, camera: Entity, ev100: f32) -> [f32; 2] {
    let actual = halves(app);
    expose(app, camera, ev100);
    settings_of(app, camera).reset = true;
    app.step(SETTLE);
    let expected = halves(app);
    [actual[0] / expected[0], actual[1] / expected[1]]
}

#[test]
fn exposure_leaves_what_is_not_exposed_alone() {
    let Some(mut app) = linear_app(SIZE) else { return };
    let app = &mut app;
    spawn_mesh(app, wall(), metal(0.3), Transform::IDENTITY);
    let panel = Rectangle::new(20.0, 40.0);
    let facing = |x: f32| Transform::from_xyz(x, 0.0, 6.0).looking_to(Vec3::Z, Vec3::Y);
    spawn_mesh(app, panel, unlit([0, 188, 0]), facing(-10.0));
    spawn_mesh(app, panel, StandardMaterial::default(), facing(10.0));
    let sun = DirectionalLight {
        illuminance: 1500.0,
        ..default()
    };
    app.world()
        .spawn((sun, Transform::default().looking_to(Vec3::new(0.5, -0.2, 1.0), Vec3::Y)));
    let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
    expose(app, camera, BRIGHT);
    reflect(app, camera, ReflectionTechnique::Quarter);
    let settings = denoised(ReflectionTechnique::Quarter);
    app.world().entity_mut(camera).insert(settings);
    warm_up(app);
    // Eyes that adapt to light and darkness, and a step.
    for (name, by, frames) in [
        ("darker by 2 % per frame", 1.02_f32.log2(), 40),
        ("brighter by 1 % per frame", -1.01_f32.log2(), 40),
        ("a step to four times", -2.0, 1),
    ] {
        expose(app, camera, BRIGHT);
        app.step(SETTLE);
        for frame in 1..=frames {
            expose(app, camera, BRIGHT + by * frame as f32);
            app.step(1);
        }
        let [unlit, sunlit] = apart(app, camera, BRIGHT + by * frames as f32);
        println!("{name}: unlit {unlit:.3}, sunlit {sunlit:.3} of the light at rest");
        let off = (unlit - 1.0).abs().max((sunlit - 1.0).abs());
        assert!(off < 0.08, "{name}: unlit {unlit}, sunlit {sunlit}");
    }
}
