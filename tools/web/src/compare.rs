//! The frame with and without ray-traced reflections, side by side: two cameras, each of which draws its part.

use bevy::{
    camera::{CameraUpdateSystems, Exposure, Hdr, SubCameraView, Viewport, visibility::VisibilitySystems},
    camera_controller::free_camera::FreeCamera,
    core_pipeline::{
        prepass::{DeferredPrepass, DepthPrepass},
        tonemapping::{DebandDither, Tonemapping},
    },
    light::Skybox,
    math::uvec2,
    prelude::*,
    window::PrimaryWindow,
};
use bevy_egui::{EguiContexts, EguiPrimaryContextPass, egui};
use std::ops::Range;

/// Compares when C is pressed, and adds a bar at the lower edge of the frame that does the same.
pub struct ComparePlugin {
    pub bar: bool,
}

impl Plugin for ComparePlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<Comparison>()
            .add_systems(Update, toggle)
            .add_systems(
                PostUpdate,
                (spawn_twin, divide_picture)
                    .chain()
                    .before(CameraUpdateSystems)
                    .before(TransformSystems::Propagate),
            )
            .add_systems(
                PostUpdate,
                keep_aspect
                    .after(CameraUpdateSystems)
                    .before(VisibilitySystems::UpdateFrusta),
            );
        if self.bar {
            app.add_systems(EguiPrimaryContextPass, show_bar);
        }
    }
}

/// Choices of the visitor.
#[derive(Resource)]
struct Comparison {
    enabled: bool,
    /// Share of the width without ray-traced reflections.
    position: f32,
}

impl Default for Comparison {
    fn default() -> Self {
        Self {
            enabled: false,
            position: 0.5,
        }
    }
}

/// The camera without reflections.
#[derive(Component)]
struct Twin;

fn show_bar(mut contexts: EguiContexts, mut comparison: ResMut<Comparison>) -> Result {
    let context = contexts.ctx_mut()?;
    egui::Area::new("compare".into())
        .anchor(egui::Align2::CENTER_BOTTOM, [0.0, -12.0])
        .show(context, |ui| {
            egui::Frame::popup(ui.style()).show(ui, |ui| {
                ui.horizontal(|ui| {
                    ui.checkbox(&mut comparison.enabled, "Compare with the environment map alone");
                    if comparison.enabled {
                        ui.add(egui::Slider::new(&mut comparison.position, 0.05..=0.95).show_value(false));
                    }
                    ui.label("W A S D Q E and the mouse: fly. C: compare. F2: settings");
                });
            });
        });
    Ok(())
}

fn toggle(keys: Res<ButtonInput<KeyCode>>, mut comparison: ResMut<Comparison>) {
    if keys.just_pressed(KeyCode::KeyC) {
        comparison.enabled ^= true;
    }
}

/// Spawns and despawns the camera without reflections.
fn spawn_twin(
    comparison: Res<Comparison>,
    cameras: Query<Entity, With<FreeCamera>>,
    twins: Query<Entity, With<Twin>>,
    mut commands: Commands,
) {
    if comparison.enabled == !twins.is_empty() {
        return;
    }
    for twin in &twins {
        commands.entity(twin).despawn();
    }
    if comparison.enabled {
        for camera in &cameras {
            let mut twin = commands.entity(camera);
            // Without the panel's context, which is on the first camera.
            let mut twin = twin.clone_and_spawn_with_opt_in(|builder| {
                builder
                    .allow::<(Camera, Camera3d, Hdr, Msaa, Projection, Transform)>()
                    .allow::<(DepthPrepass, DeferredPrepass)>()
                    .allow::<(
                        AmbientLight,
                        DebandDither,
                        EnvironmentMapLight,
                        Exposure,
                        Skybox,
                        Tonemapping,
                    )>();
            });
            twin.insert(Twin);
        }
    }
}

/// Gives each camera its columns of the frame, and the twin the pose of the original.
fn divide_picture(
    comparison: Res<Comparison>,
    window: Single<&Window, With<PrimaryWindow>>,
    mut camera: Single<(&mut Camera, &Transform), (With<FreeCamera>, Without<Twin>)>,
    mut twin: Option<Single<(&mut Camera, &mut Transform), With<Twin>>>,
) {
    let size = window.physical_size();
    let divided = twin.is_some() && size.x >= 2;
    let line = ((size.x as f32 * comparison.position) as u32).clamp(1, size.x.saturating_sub(1).max(1));
    let (camera, pose) = &mut *camera;
    set_columns(camera, size, divided.then_some(line..size.x));
    if let Some(twin) = &mut twin {
        let (twin, twin_pose) = &mut **twin;
        **twin_pose = **pose;
        set_columns(twin, size, divided.then_some(0..line));
        twin.order = -1;
    }
}

/// Culling and shadow maps use the aspect of the whole frame: they don't support parts.
fn keep_aspect(mut cameras: Query<(&Camera, &mut Projection)>) {
    for (camera, mut projection) in &mut cameras {
        if let Some(part) = &camera.sub_camera_view {
            let size = part.full_size.as_vec2();
            projection.update(size.x, size.y);
        }
    }
}

fn set_columns(camera: &mut Camera, size: UVec2, columns: Option<Range<u32>>) {
    let part = columns.map(|columns| (uvec2(columns.start, 0), uvec2(columns.end - columns.start, size.y)));
    camera.viewport = part.map(|(physical_position, physical_size)| Viewport {
        physical_position,
        physical_size,
        ..default()
    });
    camera.sub_camera_view = part.map(|(offset, part_size)| SubCameraView {
        full_size: size,
        offset: offset.as_vec2(),
        size: part_size,
    });
}
