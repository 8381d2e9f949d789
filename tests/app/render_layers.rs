//! Cameras that draw different render layers, side by side.

use crate::{
    pictures::{apps_of_both, crop, differing_pixels, pixels_like, reflect, warm_up},
    stage::{
        BEFORE_THE_MIRROR, GREEN, RED, SIZE, behind, layer_bytes, metal, report, share_picture, spawn_camera,
        spawn_mesh, unlit, wall,
    },
};
use bevy::{camera::visibility::RenderLayers, prelude::*};
use bevy_glint::{ReflectedLayers, ReflectionTechnique};
use glint_scenes::{HeadlessApp, Output, SceneName};

/// Pixels of the left and the right half that show a colour.
fn count(app: &mut HeadlessApp, color: [u8; 3]) -> [usize; 2] {
    warm_up(app);
    app.step(2);
    let picture = app.capture().unwrap();
    let half = SIZE.x as usize / 2;
    [0..half, half..2 * half].map(|columns| count_in(&crop(&picture, SIZE.x, columns), color))
}

fn count_in(picture: &[u8], color: [u8; 3]) -> usize {
    pixels_like(picture, color, 24)
}

#[test]
fn each_camera_reflects_what_it_draws() {
    for (tracer, mut app) in apps_of_both(SIZE, Output::Picture) {
        let app = &mut app;
        spawn_mesh(app, wall(), metal(0.0), Transform::IDENTITY);
        // The red sheet hides the green one.
        for (color, distance, layer) in [(RED, 7.0, 1), (GREEN, 8.0, 2)] {
            let at = behind(distance);
            let sheet = spawn_mesh(app, Rectangle::new(60.0, 60.0), unlit(color), at);
            app.world().entity_mut(sheet).insert(RenderLayers::layer(layer));
        }
        let cameras = [1, 2].map(|layer| {
            let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
            app.world()
                .entity_mut(camera)
                .insert(RenderLayers::from_layers(&[0, layer]));
            camera
        });
        share_picture(app, cameras);
        for camera in cameras {
            reflect(app, camera, ReflectionTechnique::Reference);
        }
        let half = SIZE.element_product() as usize / 2;
        let (red, green) = (count(app, RED), count(app, GREEN));
        println!("{tracer}: red {red:?}, green {green:?} of {half}");
        assert_eq!((red, green), ([half, 0], [0, half]), "{tracer}");
        // The second camera now draws the layers of the first one.
        app.world()
            .entity_mut(cameras[1])
            .insert(RenderLayers::from_layers(&[0, 1]));
        let (red, green) = (count(app, RED), count(app, GREEN));
        println!("{tracer}, the same layers: red {red:?}, green {green:?}");
        assert_eq!((red, green), ([half; 2], [0; 2]), "{tracer}");
        // Its reflections show other layers than the camera draws itself.
        let shown = ReflectedLayers(RenderLayers::from_layers(&[0, 2]));
        app.world().entity_mut(cameras[1]).insert(shown);
        let (red, green) = (count(app, RED), count(app, GREEN));
        println!("{tracer}, named layers: red {red:?}, green {green:?}");
        assert_eq!((red, green), ([half, 0], [0, half]), "{tracer}");
    }
}

#[test]
fn what_no_camera_shows_only_casts_shadows() {
    for (tracer, mut app) in apps_of_both(SIZE, Output::Picture) {
        let app = &mut app;
        spawn_mesh(app, wall(), metal(0.0), Transform::IDENTITY);
        spawn_mesh(app, Rectangle::new(60.0, 60.0), default(), behind(12.0));
        let sun = DirectionalLight {
            illuminance: 2000.0,
            shadow_maps_enabled: true,
            ..default()
        };
        let layers = RenderLayers::from_layers(&[0, 3]);
        let sun = app.world().spawn((sun, behind(0.0), layers)).id();
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
        reflect(app, camera, ReflectionTechnique::Reference);
        warm_up(app);
        app.step(2);
        let lit = app.capture().unwrap();
        // With shaders that were compiled before them.
        let materials =
            [AlphaMode::Opaque, AlphaMode::Blend, AlphaMode::Mask(0.5)].map(|alpha_mode| StandardMaterial {
                alpha_mode,
                depth_bias: 1.0,
                ..unlit(RED)
            });
        for material in materials {
            let sheet = spawn_mesh(app, Rectangle::new(3.0, 3.0), material, behind(8.0));
            app.world().entity_mut(sheet).insert(RenderLayers::layer(3));
        }
        for _ in 0..4 {
            app.step(1);
            let picture = app.capture().unwrap();
            assert_eq!(count_in(&picture, RED), 0, "{tracer}: nothing red is seen");
        }
        warm_up(app);
        app.step(2);
        let shadowed = app.capture().unwrap();
        assert_eq!(count_in(&shadowed, RED), 0, "{tracer}: nothing red is seen");
        let shadow = differing_pixels(&lit, &shadowed, 40);
        println!("{tracer}: a shadow of {shadow} pixels");
        assert!(shadow > 100, "{tracer}: a shadow of {shadow} pixels");
        assert_eq!(layer_bytes(app), 0, "{tracer}: nothing transparent is seen");
        // Without shadows, or on the camera's layers alone, the light needs none of them.
        let mut sun = app.world().get_mut::<DirectionalLight>(sun).unwrap();
        sun.shadow_maps_enabled = false;
        app.step(4);
        assert_eq!(report(app).instances, 2, "{tracer}");
    }
}
