//! Textures about reflections for other plugins, read as such a plugin reads them.

use crate::{
    pictures::{linear_app, warm_up},
    stage::{
        BEFORE_THE_MIRROR, BLUE, RED, SIZE, behind, denoised, frame, report, settings_of, spawn_mesh, spawn_mirror,
        unlit,
    },
};
use bevy::{
    prelude::*,
    render::{
        RenderApp,
        render_resource::{PipelineCache, PipelineDescriptor, Texture, TextureView},
        sync_world::RenderEntity,
    },
};
use bevy_glint::{
    RayTracedReflections, ReflectionDenoiser, ReflectionGuideTextures, ReflectionGuides, ReflectionTechnique,
};
use glint_scenes::{HeadlessApp, SceneName, decode_halves, read_texture};

/// Metres from the camera to the mirror, and from the mirror to the surface behind the camera.
const TO_MIRROR: f32 = BEFORE_THE_MIRROR.translation.z;
const BEHIND: f32 = 7.0;
/// Metres by which the camera moves to the right in each frame.
const STEP: f32 = 0.02;

/// A camera that moves sideways before a mirror, and what the mirror reflects.
struct Stage {
    app: HeadlessApp,
    camera: Entity,
}

impl Stage {
    fn new(roughness: f32) -> Option<Self> {
        let mut app = linear_app(SIZE)?;
        let camera = spawn_mirror(&mut app, roughness, SceneName::MirrorRoom);
        let facing_the_mirror = behind(BEHIND);
        spawn_mesh(&mut app, Rectangle::new(60.0, 60.0), unlit(RED), facing_the_mirror);
        let settings = denoised(ReflectionTechnique::Variable);
        app.world().entity_mut(camera).insert(settings);
        warm_up(&mut app);
        Some(Self { app, camera })
    }

    fn with_guides(roughness: f32) -> Option<Self> {
        let mut stage = Self::new(roughness)?;
        stage.app.world().entity_mut(stage.camera).insert(ReflectionGuides);
        warm_up(&mut stage.app);
        Some(stage)
    }

    /// Compiled pipelines, and those that are being compiled, of the pass that fills the textures.
    fn pipelines(&self) -> usize {
        let cache = self.app.render_world().unwrap().resource::<PipelineCache>();
        let is_ours = |descriptor: &PipelineDescriptor| matches!(descriptor, PipelineDescriptor::RenderPipelineDescriptor(pass) if pass.label.as_deref() == Some("glint_guides"));
        cache
            .pipelines()
            .filter(|pipeline| is_ours(&pipeline.descriptor))
            .count()
    }

    /// Draws some frames while the camera moves to the right.
    fn walk(&mut self, frames: u32) {
        for _ in 0..frames {
            let mut place = self.app.world().get_mut::<Transform>(self.camera).unwrap();
            place.translation.x += STEP;
            self.app.step(1);
        }
    }

    fn guides(&mut self) -> Option<ReflectionGuideTextures> {
        let view = self.app.world().get::<RenderEntity>(self.camera)?.id();
        let world = self.app.app().sub_app(RenderApp).world();
        world.get::<ReflectionGuideTextures>(view).cloned()
    }

    /// Memory of the textures, as reported.
    fn bytes(&mut self) -> u64 {
        let labels = ["glint_specular_motion", "glint_hit_distance", "glint_reactive_mask"];
        let parts = report(&mut self.app).view_memory.remove(0).parts;
        let ours = parts.iter().filter(|(label, _)| labels.contains(label));
        ours.map(|(_, bytes)| bytes).sum()
    }

    /// The bytes of the texel in the middle of the view.
    fn middle(&self, view: &TextureView) -> Vec<u8> {
        let texture = &Texture::from(view.texture().clone());
        let bytes = read_texture(self.app.render_world().unwrap(), texture).unwrap();
        let texel = texture.format().block_copy_size(None).unwrap() as usize;
        let first = (SIZE.y / 2 * texture.width() + SIZE.x / 2) as usize * texel;
        bytes[first..first + texel].to_vec()
    }

    /// Horizontal specular motion, hit distance and reactive mask in the middle of the view.
    fn seen(&mut self) -> [f32; 3] {
        let guides = self.guides().expect("the camera has guides");
        assert_eq!(guides.size, SIZE);
        let half = |bytes: &[u8]| decode_halves(&[bytes[0], bytes[1], 0, 0, 0, 0, 0, 0])[0][0];
        [
            half(&self.middle(&guides.specular_motion)),
            half(&self.middle(&guides.hit_distance)),
            f32::from(self.middle(&guides.reactive_mask)[0]) / 255.0,
        ]
    }
}

/// Motion in fractions of the view of a point before the camera, which moves by [`STEP`].
fn motion_at(depth: f32) -> f32 {
    let PerspectiveProjection { fov, .. } = PerspectiveProjection::default();
    let aspect = SIZE.x as f32 / SIZE.y as f32;
    -0.5 * STEP / (depth * aspect * (0.5 * fov).tan())
}

#[track_caller]
fn assert_near(what: &str, actual: f32, expected: f32, tolerance: f32) {
    let error = (actual - expected).abs();
    assert!(
        error <= tolerance * expected.abs(),
        "{what}: {actual}, expected {expected}"
    );
}

#[test]
fn a_mirror_describes_its_image() {
    let Some(mut stage) = Stage::with_guides(0.0) else {
        return;
    };
    for half_resolution in [false, true] {
        settings_of(&mut stage.app, stage.camera).denoiser = ReflectionDenoiser {
            half_resolution,
            ..default()
        };
        warm_up(&mut stage.app);
        stage.walk(6);
        let [motion, distance, mask] = stage.seen();
        assert_near("motion", motion, motion_at(TO_MIRROR + BEHIND), 0.02);
        assert_near("distance", distance, BEHIND, 0.01);
        let pixels = (motion_at(TO_MIRROR) - motion_at(TO_MIRROR + BEHIND)).abs() * SIZE.x as f32;
        assert_near("mask", mask, pixels.min(1.0), 0.05);
        // At rest.
        stage.app.step(3);
        let [motion, distance, mask] = stage.seen();
        assert_near("distance at rest", distance, BEHIND, 0.01);
        assert!(motion.abs() < 1e-5 && mask < 0.01, "{motion}, {mask}");
    }
}

#[test]
fn a_rough_wall_moves_as_its_surface() {
    let Some(mut stage) = Stage::with_guides(0.7) else {
        return;
    };
    stage.walk(6);
    let [motion, distance, mask] = stage.seen();
    assert_near("motion", motion, motion_at(TO_MIRROR), 0.02);
    assert!((BEHIND..BEHIND + 20.0).contains(&distance), "{distance}");
    assert!(mask < 0.01, "{mask}");
}

#[test]
fn cameras_without_the_component_have_no_guides() {
    let Some(mut stage) = Stage::new(0.0) else { return };
    assert!(stage.guides().is_none());
    assert_eq!((stage.pipelines(), stage.bytes()), (0, 0), "others pay nothing");
    stage.app.world().entity_mut(stage.camera).insert(ReflectionGuides);
    warm_up(&mut stage.app);
    assert!(stage.guides().is_some());
    assert_eq!(stage.pipelines(), 1);
    assert_eq!(stage.bytes(), 7 * u64::from(SIZE.x * SIZE.y));
    stage.app.world().entity_mut(stage.camera).remove::<ReflectionGuides>();
    stage.app.step(3);
    assert!(stage.guides().is_none(), "removed");
    assert_eq!(stage.bytes(), 0);
    let camera = stage.camera;
    stage.app.world().entity_mut(camera).insert(ReflectionGuides);
    stage.app.step(3);
    assert!(stage.guides().is_some(), "inserted again");
    stage.app.world().entity_mut(camera).remove::<RayTracedReflections>();
    stage.app.step(3);
    assert!(stage.guides().is_none(), "without reflections");
}

#[test]
fn what_moves_before_a_mirror_is_reactive() {
    let Some(mut stage) = Stage::with_guides(0.0) else {
        return;
    };
    let before = behind(6.0);
    let board = spawn_mesh(&mut stage.app, Rectangle::new(4.0, 4.0), unlit(BLUE), before);
    // Mirrors with rays of their own, and without.
    for own_rays in [true, false] {
        settings_of(&mut stage.app, stage.camera).full_resolution_mirrors = own_rays;
        warm_up(&mut stage.app);
        stage.app.step(8);
        let [_, distance, mask] = stage.seen();
        assert_near("distance", distance, 6.0, 0.01);
        assert!(mask < 0.01, "own rays {own_rays}, at rest: {mask}");
        for _ in 0..3 {
            let mut place = stage.app.world().get_mut::<Transform>(board).unwrap();
            place.translation.x += STEP;
            stage.app.step(1);
        }
        let [_, _, mask] = stage.seen();
        assert!(mask > 0.9, "own rays {own_rays}, moving: {mask}");
    }
}

/// A camera that sees nothing reflective traces nothing.
#[test]
fn guides_of_a_view_without_reflections_are_cleared() {
    let Some(mut stage) = Stage::with_guides(0.0) else {
        return;
    };
    stage.walk(2);
    assert!(stage.seen()[1] > 0.0);
    let away = BEFORE_THE_MIRROR.looking_to(Vec3::Z, Vec3::Y);
    *stage.app.world().get_mut::<Transform>(stage.camera).unwrap() = away;
    (0..40).for_each(|_| frame(&mut stage.app));
    assert_eq!(report(&mut stage.app).culled_views, 1);
    // The surface that it sees moves.
    stage.walk(2);
    assert_eq!(stage.seen(), [0.0; 3]);
}
