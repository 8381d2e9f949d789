//! Odd projections, poses and sizes of the camera, and further cameras.

use super::Builder;
use bevy::{
    camera::{ScalingMode, Viewport},
    prelude::*,
};
use bevy_glint::{DebugView, Preset, Technique};
use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// Views.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum ViewKind {
    /// The whole scene 1e6 metres from the origin.
    FarFromOrigin,
    /// The whole scene at a scale of 1e-4.
    Shrunk,
    /// A near plane at 1e-6.
    TinyNear,
    /// A near plane beyond the scene.
    HugeNear,
    /// A far plane at infinity.
    InfiniteFar,
    /// Orthographic.
    Orthographic,
    /// Orthographic, a tenth of a millimetre high.
    TinyOrthographic,
    /// Orthographic, 1e6 metres high.
    HugeOrthographic,
    /// A field of view of a thousandth of a radian.
    NarrowField,
    /// A field of view of almost half a turn.
    WideField,
    /// A field of view of zero.
    ZeroField,
    /// Over-exposed by 60 stops.
    OverExposed,
    /// Under-exposed by 80 stops.
    UnderExposed,
    /// An exposure that is NaN.
    NanExposure,
    /// An infinite exposure.
    InfiniteExposure,
    /// A camera position that is NaN.
    NanCamera,
    /// A camera with a scale of zero.
    FlatCamera,
    /// A camera with a negative scale.
    MirroredCamera,
    /// A view along the floor.
    Grazing,
    /// A view away from the scene.
    Away,
    /// One pixel.
    OnePixel,
    /// Three pixels in a row.
    ThreePixels,
    /// One pixel high and wider than a workgroup list.
    Ribbon,
    /// A viewport of a part of the target.
    Viewport,
    /// A viewport of one pixel.
    TinyViewport,
    /// Front faces culled instead of back faces.
    InvertedCulling,
    /// Two cameras with different settings.
    TwoCameras,
    /// A second camera that doesn't reflect.
    PlainCamera,
    /// A camera for each preset.
    ManyCameras,
    /// 7680x4320 pixels on a GPU; as wide but lower on the CPU.
    EightThousand,
}

/// Changes the view, or adds cameras.
pub fn add(kind: ViewKind, builder: &mut Builder) {
    match kind {
        ViewKind::FarFromOrigin => place_root(builder, Transform::from_xyz(1e6, 3e5, -1e6)),
        ViewKind::Shrunk => place_root(builder, Transform::from_scale(Vec3::splat(1e-4))),
        ViewKind::NanCamera => builder.camera.transform.translation.y = f32::NAN,
        ViewKind::FlatCamera => builder.camera.transform.scale = Vec3::ZERO,
        ViewKind::MirroredCamera => builder.camera.transform.scale.x = -1.0,
        ViewKind::Grazing => {
            let low = Transform::from_xyz(0.0, 1e-3, 3.0);
            builder.camera.transform = low.looking_at(Vec3::new(0.0, 1e-3, 0.0), Vec3::Y);
        }
        ViewKind::Away => builder.camera.transform.rotate_y(core::f32::consts::PI),
        ViewKind::InvertedCulling => builder.camera.camera.invert_culling = true,
        ViewKind::OverExposed => builder.camera.exposure.ev100 = -60.0,
        ViewKind::UnderExposed => builder.camera.exposure.ev100 = 80.0,
        ViewKind::NanExposure => builder.camera.exposure.ev100 = f32::NAN,
        ViewKind::InfiniteExposure => builder.camera.exposure.ev100 = f32::NEG_INFINITY,
        ViewKind::OnePixel => builder.camera.size = UVec2::ONE,
        ViewKind::ThreePixels => builder.camera.size = UVec2::new(3, 1),
        ViewKind::Ribbon => builder.camera.size = UVec2::new(2049, 1),
        ViewKind::EightThousand => {
            let height = if builder.harness.is_cpu() { 16 } else { 4320 };
            builder.camera.size = UVec2::new(7680, height);
        }
        ViewKind::Viewport | ViewKind::TinyViewport => {
            let size = builder.camera.size;
            let part = if kind == ViewKind::Viewport {
                (size * 2 / 3).max(UVec2::ONE)
            } else {
                UVec2::ONE
            };
            builder.camera.camera.viewport = Some(Viewport {
                physical_position: size - part,
                physical_size: part,
                ..default()
            });
        }
        ViewKind::TwoCameras | ViewKind::PlainCamera | ViewKind::ManyCameras => more_cameras(kind, builder),
        _ => builder.camera.projection = projection(kind),
    }
}

fn place_root(builder: &mut Builder, transform: Transform) {
    let root = builder.root;
    builder.world().entity_mut(root).insert(transform);
}

fn projection(kind: ViewKind) -> Projection {
    let orthographic = |viewport_height: f32| {
        Projection::from(OrthographicProjection {
            scaling_mode: ScalingMode::FixedVertical { viewport_height },
            near: -10.0,
            far: 100.0,
            ..OrthographicProjection::default_3d()
        })
    };
    let mut perspective = PerspectiveProjection::default();
    match kind {
        ViewKind::Orthographic => return orthographic(3.0),
        ViewKind::TinyOrthographic => return orthographic(1e-4),
        ViewKind::HugeOrthographic => return orthographic(1e6),
        ViewKind::TinyNear => perspective.near = 1e-6,
        ViewKind::HugeNear => perspective.near = 100.0,
        ViewKind::InfiniteFar => perspective.far = f32::INFINITY,
        ViewKind::NarrowField => perspective.fov = 1e-3,
        ViewKind::WideField => perspective.fov = 3.1,
        ViewKind::ZeroField => perspective.fov = 0.0,
        _ => {}
    }
    perspective.into()
}

fn more_cameras(kind: ViewKind, builder: &mut Builder) {
    let mut other = builder.camera.clone();
    other.transform.translation.x = -0.8;
    other.size = UVec2::new(19, 31);
    match kind {
        ViewKind::PlainCamera => {
            other.reflections = None;
            builder.more_cameras.push(other);
        }
        ViewKind::ManyCameras => {
            for preset in Preset::ALL {
                let (reflections, heuristic) = preset.settings();
                let mut camera = other.clone();
                camera.reflections = Some(reflections);
                camera.heuristic = heuristic;
                builder.more_cameras.push(camera);
            }
        }
        _ => {
            let reflections = other.reflections.get_or_insert_default();
            reflections.technique = Technique::Reference;
            reflections.shadow_rays = false;
            reflections.denoiser.temporal = false;
            other.view = DebugView::Reflection;
            other.exposure.ev100 = 2.0;
            builder.more_cameras.push(other);
        }
    }
}
