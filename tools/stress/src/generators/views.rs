//! Odd projections, poses and sizes of the camera, and further cameras.

use super::{Builder, CameraSetup};
use bevy::{
    camera::{ScalingMode, Viewport},
    prelude::*,
};
use bevy_glint::{ReflectionDebugView, ReflectionPreset, ReflectionTechnique};

kinds! {
    /// Views: changes of the camera, and further cameras.
    ViewKind, pub fn add(builder: &mut Builder) {
        FarFromOrigin => place_root(builder, Transform::from_xyz(1e6, 3e5, -1e6)),
        Shrunk => place_root(builder, Transform::from_scale(Vec3::splat(1e-4))),
        TinyNear => perspective(builder, |projection| projection.near = 1e-6),
        // Beyond the scene.
        HugeNear => perspective(builder, |projection| projection.near = 100.0),
        InfiniteFar => perspective(builder, |projection| projection.far = f32::INFINITY),
        Orthographic => orthographic(builder, 3.0),
        TinyOrthographic => orthographic(builder, 1e-4),
        HugeOrthographic => orthographic(builder, 1e6),
        NarrowField => perspective(builder, |projection| projection.fov = 1e-3),
        WideField => perspective(builder, |projection| projection.fov = 3.1),
        ZeroField => perspective(builder, |projection| projection.fov = 0.0),
        OverExposed => builder.scene.camera.exposure.ev100 = -60.0,
        UnderExposed => builder.scene.camera.exposure.ev100 = 80.0,
        NanExposure => builder.scene.camera.exposure.ev100 = f32::NAN,
        InfiniteExposure => builder.scene.camera.exposure.ev100 = f32::NEG_INFINITY,
        NanCamera => builder.scene.camera.transform.translation.y = f32::NAN,
        FlatCamera => builder.scene.camera.transform.scale = Vec3::ZERO,
        MirroredCamera => builder.scene.camera.transform.scale.x = -1.0,
        // Along the floor.
        Grazing => builder.scene.camera.transform =
            Transform::from_xyz(0.0, 1e-3, 3.0).looking_at(Vec3::new(0.0, 1e-3, 0.0), Vec3::Y),
        Away => builder.scene.camera.transform.rotate_y(core::f32::consts::PI),
        OnePixel => builder.scene.camera.size = UVec2::ONE,
        ThreePixels => builder.scene.camera.size = UVec2::new(3, 1),
        // Wider than a workgroup list.
        Ribbon => builder.scene.camera.size = UVec2::new(2049, 1),
        Viewport => viewport(builder, (builder.scene.camera.size * 2 / 3).max(UVec2::ONE)),
        TinyViewport => viewport(builder, UVec2::ONE),
        InvertedCulling => builder.scene.camera.camera.invert_culling = true,
        TwoCameras => two_cameras(builder),
        PlainCamera => add_camera(builder, |camera| camera.reflections = None),
        // One for each preset.
        ManyCameras => ReflectionPreset::ALL.into_iter().for_each(|preset| add_camera(builder, |camera| {
            let (reflections, heuristic) = preset.settings();
            (camera.reflections, camera.heuristic) = (Some(reflections), heuristic);
        })),
        // Lower on the CPU.
        EightThousand => builder.scene.camera.size = UVec2::new(7680, if builder.harness.is_cpu() { 16 } else { 4320 }),
    }
}

fn place_root(builder: &mut Builder, transform: Transform) {
    let root = builder.scene.root;
    builder.world().entity_mut(root).insert(transform);
}

fn orthographic(builder: &mut Builder, viewport_height: f32) {
    builder.scene.camera.projection = Projection::from(OrthographicProjection {
        scaling_mode: ScalingMode::FixedVertical { viewport_height },
        near: -10.0,
        far: 100.0,
        ..OrthographicProjection::default_3d()
    });
}

fn perspective(builder: &mut Builder, change: impl FnOnce(&mut PerspectiveProjection)) {
    let mut projection = PerspectiveProjection::default();
    change(&mut projection);
    builder.scene.camera.projection = projection.into();
}

fn viewport(builder: &mut Builder, part: UVec2) {
    let camera = &mut builder.scene.camera;
    camera.camera.viewport = Some(Viewport {
        physical_position: camera.size - part,
        physical_size: part,
        ..default()
    });
}

/// Adds a camera beside the first one.
fn add_camera(builder: &mut Builder, change: impl FnOnce(&mut CameraSetup)) {
    let mut camera = builder.scene.camera.clone();
    camera.transform.translation.x = -0.8;
    camera.size = UVec2::new(19, 31);
    change(&mut camera);
    builder.more_cameras.push(camera);
}

/// Adds one with other settings.
fn two_cameras(builder: &mut Builder) {
    add_camera(builder, |camera| {
        let reflections = camera.reflections.get_or_insert_default();
        reflections.technique = ReflectionTechnique::Reference;
        reflections.shadow_rays = false;
        reflections.denoiser.temporal = false;
        camera.view = ReflectionDebugView::Reflection;
        camera.exposure.ev100 = 2.0;
    });
}
