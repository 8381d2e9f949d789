//! Light that the last frame showed, in place of shading.

mod march;

use crate::{
    common::app_of,
    pictures::{any_tracer, apps, differing_pixels, dump, flip, reflect, warm_up},
    stage::{
        BLUE, SIZE, clear_glass, metal, report, set_shader, spawn_camera, spawn_mesh, spawn_of, unlit, until_at_rest,
    },
};
use bevy::{
    asset::uuid_handle,
    camera::Exposure,
    light::{CascadeShadowConfigBuilder, DirectionalLightShadowMap},
    prelude::*,
    render::{render_resource::AsBindGroup, settings::WgpuSettings},
    shader::{Shader, ShaderRef},
};
use bevy_glint::{
    RayTracedReflections, ReflectedMaterial, ReflectedMaterialPlugin, ReflectionDenoiser, ReflectionTechnique,
    ReflectionTracerChoice, ScreenTraces,
};
use glint_scenes::{HeadlessApp, HeadlessSettings, Output, SceneName, browser_device};

/// Bytes of the copied screen, per pixel.
const BYTES_PER_PIXEL: u64 = 8;
/// Mean FLIP of a reflection with the custom shader and the image of a camera in its place: the edges of stripes are as wide as pixels of
/// the last frame.
const SAME: f32 = 0.045;
/// Minimum mean FLIP to a reflection without the custom shader.
const OTHER: f32 = 0.1;

const SHADER: Handle<Shader> = uuid_handle!("9d0f3a52-7c1e-4f7b-8f0d-1d0f6a2b7c33");
/// Rays don't see these stripes.
const SOURCE: &str = "
    import bevy_pbr::render::forward_io::VertexOutput;
    @fragment
    fn fragment(in: VertexOutput) -> @location(0) vec4<f32> {
        return select(vec4(1.0, 0.1, 0.0, 1.0), vec4(0.0, 0.8, 0.1, 1.0), fract(2.5 * in.uv.x) > 0.5);
    }
";

/// A material with its own shader.
#[derive(Asset, AsBindGroup, Reflect, Clone, Default)]
struct Stripes {}

impl Material for Stripes {
    fn fragment_shader() -> ShaderRef {
        SHADER.into()
    }
}

impl ReflectedMaterial for Stripes {
    fn reflected(&self) -> StandardMaterial {
        unlit(BLUE)
    }
}

/// The camera sees a striped board on a mirroring floor.
struct Stage {
    app: HeadlessApp,
    camera: Entity,
    floor: Entity,
    board: Entity,
}

const EYE: Vec3 = Vec3::new(0.0, 1.2, 4.0);

/// Across the view, above the floor or mirrored in it.
fn place(height: f32) -> Transform {
    Transform::from_xyz(0.1, height, 0.0)
}

fn view_from(eye: Vec3) -> Transform {
    Transform::from_translation(eye).looking_at(Vec3::ZERO, Vec3::Y)
}

impl Stage {
    fn new(tracer: ReflectionTracerChoice, floor: StandardMaterial) -> Option<Self> {
        Self::on(default(), tracer, floor)
    }

    /// With a smooth floor.
    fn smooth() -> Option<Self> {
        Self::new(ReflectionTracerChoice::Bvh, metal(0.0))
    }

    fn on(device: WgpuSettings, tracer: ReflectionTracerChoice, floor: StandardMaterial) -> Option<Self> {
        let settings = HeadlessSettings {
            size: SIZE,
            device,
            ..default()
        };
        let add = |app: &mut App| {
            app.add_plugins((
                ReflectedMaterialPlugin::<Stripes>::default(),
                MaterialPlugin::<Stripes>::default(),
            ));
        };
        let mut app = app_of(settings, tracer, |_| {}, add)?;
        set_shader(&mut app, &SHADER, SOURCE, "tests/stripes_of_screen.wesl");
        let lying = Transform::default().looking_to(Vec3::NEG_Y, Vec3::NEG_Z);
        let floor = spawn_mesh(&mut app, Rectangle::new(30.0, 30.0), floor, lying);
        let board = spawn_board(&mut app, place(0.7));
        let camera = spawn_camera(&mut app, view_from(EYE), SceneName::MirrorRoom);
        Some(Self {
            app,
            camera,
            floor,
            board,
        })
    }

    fn set(&mut self, change: impl FnOnce(&mut RayTracedReflections)) {
        let settings = self.app.world().get_mut::<RayTracedReflections>(self.camera);
        change(&mut settings.unwrap());
        // The report is one frame old.
        self.app.step(2);
        warm_up(&mut self.app);
    }

    /// The image after some frames, without any earlier history.
    fn capture(&mut self, screen_traces: ScreenTraces) -> Vec<u8> {
        self.set(|settings| settings.screen_traces = screen_traces);
        let mut settings = self.app.world().get_mut::<RayTracedReflections>(self.camera).unwrap();
        settings.reset = true;
        self.app.step(4);
        self.app.capture().unwrap()
    }

    /// The expected image in the mirror: a second board under the floor, with the floor hidden.
    fn expected(&mut self) -> Vec<u8> {
        let twin = spawn_board(&mut self.app, place(-0.7));
        *self.app.world().get_mut::<Visibility>(self.floor).unwrap() = Visibility::Hidden;
        warm_up(&mut self.app);
        self.app.step(2);
        let expected = self.app.capture().unwrap();
        self.app.world().despawn(twin);
        *self.app.world().get_mut::<Visibility>(self.floor).unwrap() = Visibility::Inherited;
        self.app.step(2);
        expected
    }

    /// Asserts that the mirror shows the stripes, which are visible only on the screen.
    #[track_caller]
    fn assert_shows(&mut self, name: &str, expected: &[u8]) {
        let without = self.capture(ScreenTraces::Off);
        let with = self.capture(ScreenTraces::Reuse);
        dump(&format!("{name}-off"), SIZE, expected, &without);
        dump(&format!("{name}-reuse"), SIZE, expected, &with);
        let same = flip(LOWER, lower(expected), lower(&with)).0;
        let other = flip(LOWER, lower(expected), lower(&without)).0;
        println!("{name}: mean FLIP {same} with, {other} without");
        assert!(same < SAME, "{name}: the mirror lacks the stripes: {same}");
        assert!(other > OTHER, "{name}: rays see the stripes by themselves: {other}");
    }

    /// The image of a camera that has turned by three pixels since the last frame.
    fn pan(&mut self) -> Vec<u8> {
        for frames in (0..6).rev() {
            let aside = Vec3::X * 0.15 * frames as f32;
            let pan = Transform::from_translation(EYE).looking_at(aside, Vec3::Y);
            self.app.world().entity_mut(self.camera).insert(pan);
            self.app.step(1);
        }
        self.app.capture().unwrap()
    }

    /// Returns a name for images.
    fn trace_by(&mut self, (technique, own_rays, max_bounces): (ReflectionTechnique, bool, u32)) -> String {
        self.set(|settings| {
            settings.technique = technique;
            settings.full_resolution_mirrors = own_rays;
            settings.max_bounces = max_bounces;
        });
        format!("{technique:?}-{max_bounces}")
    }

    /// Bytes of the copied screen, and of all that the camera owns.
    fn bytes(&mut self) -> (u64, u64) {
        let memory = report(&mut self.app).view_memory;
        let parts = || memory.iter().flat_map(|view| &view.parts);
        let screen = parts().filter(|(label, _)| *label == "glint_screen");
        (
            screen.map(|(_, bytes)| bytes).sum(),
            parts().map(|(_, bytes)| bytes).sum(),
        )
    }
}

fn spawn_board(app: &mut HeadlessApp, at: Transform) -> Entity {
    spawn_of(app, Rectangle::new(2.0, 1.0), Stripes {}, at)
}

/// The lower half of an image, which shows the floor.
fn lower(picture: &[u8]) -> &[u8] {
    &picture[picture.len() / 2..]
}

/// Techniques, whether mirrors have their own rays, and bounces. Rays of blocks come first, then mirrors in parallel to the shading of
/// their hits, and before they bounce.
const WAYS: [(ReflectionTechnique, bool, u32); 3] = [
    (ReflectionTechnique::Reference, false, 1),
    (ReflectionTechnique::Variable, true, 1),
    (ReflectionTechnique::Quarter, true, 3),
];

const LOWER: UVec2 = UVec2::new(SIZE.x, SIZE.y / 2);

#[test]
fn reflections_show_the_shaders_of_the_screen() {
    for tracer in any_tracer() {
        let Some(mut stage) = Stage::new(tracer, metal(0.0)) else {
            continue;
        };
        reflect(&mut stage.app, stage.camera, ReflectionTechnique::Reference);
        let expected = stage.expected();
        for way in WAYS {
            let name = format!("screen-{tracer:?}-{}", stage.trace_by(way));
            stage.assert_shows(&name, &expected);
        }
        the_ground_truth_shades_all(&mut stage);
        objects_that_move_are_shaded(&mut stage);
        views_at_rest_converge_to_what_rays_see(&mut stage);
        views_in_motion_find_what_they_saw(&mut stage, &expected);
    }
}

/// All that the passes bind fits into the limits of WebGPU.
#[test]
fn browsers_have_room_for_the_screen() {
    let Some(mut stage) = Stage::on(browser_device(), ReflectionTracerChoice::Bvh, metal(0.0)) else {
        return;
    };
    reflect(&mut stage.app, stage.camera, ReflectionTechnique::Quarter);
    let expected = stage.expected();
    stage.set(|settings| settings.full_resolution_mirrors = true);
    stage.assert_shows("screen-browser", &expected);
}

fn the_ground_truth_shades_all(stage: &mut Stage) {
    stage.set(|settings| {
        settings.technique = ReflectionTechnique::Converged;
        settings.max_bounces = 1;
    });
    let without = stage.capture(ScreenTraces::Off);
    let with = stage.capture(ScreenTraces::Reuse);
    assert_eq!(stage.bytes().0, 0);
    assert_eq!(differing_pixels(&without, &with, 0), 0);
    stage.set(|settings| settings.technique = ReflectionTechnique::Reference);
}

/// The last frame doesn't contain the light of objects at their new places.
fn objects_that_move_are_shaded(stage: &mut Stage) {
    let move_on = |stage: &mut Stage, screen_traces| {
        stage.capture(screen_traces);
        let mut at = stage.app.world().get_mut::<Transform>(stage.board).unwrap();
        at.translation.x += 0.3;
        stage.app.step(1);
        let moved = stage.app.capture().unwrap();
        *stage.app.world().get_mut::<Transform>(stage.board).unwrap() = place(0.7);
        moved
    };
    let without = move_on(stage, ScreenTraces::Off);
    let with = move_on(stage, ScreenTraces::Reuse);
    assert_eq!(differing_pixels(&without, &with, 0), 0);
}

fn views_at_rest_converge_to_what_rays_see(stage: &mut Stage) {
    stage.set(|settings| settings.denoiser = default());
    let mut at_rest = |screen_traces| {
        stage.capture(screen_traces);
        until_at_rest(&mut stage.app);
        stage.app.step(20);
        stage.app.capture().unwrap()
    };
    let [without, with] = [ScreenTraces::Off, ScreenTraces::Reuse].map(&mut at_rest);
    assert_eq!(differing_pixels(&without, &with, 1), 0);
}

/// The camera of the last frame was turned by three pixels. Mirrors with their own rays have no history that could hide it.
fn views_in_motion_find_what_they_saw(stage: &mut Stage, expected: &[u8]) {
    stage.set(|settings| {
        settings.technique = ReflectionTechnique::Variable;
        settings.full_resolution_mirrors = true;
    });
    let moved = stage.pan();
    dump("screen-in-motion", SIZE, expected, &moved);
    let same = flip(LOWER, lower(expected), lower(&moved)).0;
    println!("in motion: mean FLIP {same}");
    assert!(same < SAME, "{same}");
}

#[test]
fn reflections_on_glass_show_this_frame() {
    let glass = clear_glass();
    let Some(mut stage) = Stage::new(ReflectionTracerChoice::Bvh, glass) else {
        return;
    };
    reflect(&mut stage.app, stage.camera, ReflectionTechnique::Reference);
    let without = stage.capture(ScreenTraces::Off);
    let with = stage.capture(ScreenTraces::Reuse);
    let folder = dump("screen-glass", SIZE, &without, &with);
    println!("pictures in {}", folder.display());
    // Blue becomes red or green.
    let sums = |picture: &[u8]| {
        let mut sums = [0u32; 3];
        for pixel in lower(picture).chunks_exact(4) {
            (0..3).for_each(|channel| sums[channel] += u32::from(pixel[channel]));
        }
        sums
    };
    let ([red, _, blue], [shown_red, shown_green, shown_blue]) = (sums(&without), sums(&with));
    println!("{red} {blue}; {shown_red} {shown_green} {shown_blue}");
    assert!(blue > 10 * red.max(1));
    assert!(shown_red > shown_blue && shown_green > shown_blue);
}

#[test]
fn switched_off_it_leaves_nothing() {
    let Some(mut stage) = Stage::smooth() else { return };
    reflect(&mut stage.app, stage.camera, ReflectionTechnique::Reference);
    let before = stage.capture(ScreenTraces::Off);
    let (screen, all) = stage.bytes();
    assert_eq!(screen, 0);
    let with = stage.capture(ScreenTraces::Reuse);
    let pixels = u64::from(SIZE.x * SIZE.y);
    let (more, more_in_all) = stage.bytes();
    assert_eq!(
        (more, more_in_all - all),
        (BYTES_PER_PIXEL * pixels, BYTES_PER_PIXEL * pixels)
    );
    assert!(differing_pixels(&before, &with, 8) > 20, "it shows nothing");
    let after = stage.capture(ScreenTraces::Off);
    assert_eq!(stage.bytes(), (0, all));
    assert_eq!(differing_pixels(&before, &after, 0), 0);
}

/// The first frame after a cut has no last frame, and after an unannounced cut it shows nothing that isn't there.
#[test]
fn cuts_leave_no_ghosts() {
    let Some(mut stage) = Stage::smooth() else { return };
    let there = view_from(Vec3::new(1.5, 0.9, 3.0));
    reflect(&mut stage.app, stage.camera, ReflectionTechnique::Reference);
    let before = stage.capture(ScreenTraces::Reuse);
    let mut cut = |screen_traces, announced, frames| {
        stage.app.world().entity_mut(stage.camera).insert(view_from(EYE));
        stage.capture(screen_traces);
        stage.app.world().entity_mut(stage.camera).insert(there);
        let settings = stage.app.world().get_mut::<RayTracedReflections>(stage.camera);
        settings.unwrap().reset = announced;
        stage.app.step(frames);
        stage.app.capture().unwrap()
    };
    let shaded = cut(ScreenTraces::Off, true, 1);
    let first = cut(ScreenTraces::Reuse, true, 1);
    assert_eq!(differing_pixels(&shaded, &first, 0), 0, "the first frame shades all");
    let settled = cut(ScreenTraces::Reuse, true, 4);
    let unannounced = cut(ScreenTraces::Reuse, false, 1);
    dump("screen-cut", SIZE, &settled, &unannounced);
    // Stripes come from the old place of the board.
    let same = flip(SIZE, &settled, &unannounced).0;
    let other = flip(SIZE, &before, &unannounced).0;
    println!("mean FLIP {same} to later frames, {other} to the frame before the cut");
    assert!(same < SAME, "{same}");
    assert!(other > OTHER, "the cut shows the same: {other}");
}

/// Allowed increase of the error with the light of the last frame: mean FLIP.
const MORE: f32 = 0.01;
const STANDARD: UVec2 = UVec2::new(144, 96);

/// Rough boxes and a wall in the sun, on a glossy floor.
fn spawn_standard_scene(app: &mut HeadlessApp) -> Entity {
    let colored = |red, green, blue, perceptual_roughness| StandardMaterial {
        base_color: Color::srgb(red, green, blue),
        perceptual_roughness,
        ..default()
    };
    let lying = Transform::default().looking_to(Vec3::NEG_Y, Vec3::NEG_Z);
    let floor = StandardMaterial {
        reflectance: 1.0,
        ..colored(0.05, 0.05, 0.06, 0.2)
    };
    spawn_mesh(app, Rectangle::new(30.0, 30.0), floor, lying);
    let at = |x: f32, y: f32, z: f32| Transform::from_xyz(x, y, z).with_rotation(Quat::from_rotation_y(0.4 * x));
    for (size, material, at) in [
        (1.0, colored(0.8, 0.2, 0.1, 0.5), at(-1.2, 0.5, 0.0)),
        (0.8, colored(0.2, 0.7, 0.2, 0.8), at(0.3, 0.4, 0.6)),
        (1.4, colored(0.9, 0.8, 0.3, 0.4), at(1.6, 0.7, -0.8)),
    ] {
        spawn_mesh(app, Cuboid::from_length(size), material, at);
    }
    let wall = Transform::from_xyz(0.0, 1.5, -3.0);
    spawn_mesh(app, Cuboid::new(9.0, 3.0, 0.4), colored(0.7, 0.7, 0.75, 0.9), wall);
    // The image uses shadow maps: here they are fine enough.
    app.world().insert_resource(DirectionalLightShadowMap { size: 1024 });
    let shadows = CascadeShadowConfigBuilder {
        num_cascades: 1,
        maximum_distance: 14.0,
        ..default()
    };
    app.world().spawn((
        DirectionalLight {
            illuminance: 700.0,
            shadow_maps_enabled: true,
            ..default()
        },
        shadows.build(),
        Transform::default().looking_to(Vec3::new(0.6, -1.0, -0.8), Vec3::Y),
    ));
    let ambient = AmbientLight {
        brightness: 60.0,
        ..default()
    };
    let camera = spawn_camera(app, view_from(Vec3::new(0.5, 1.6, 5.0)), SceneName::MirrorRoom);
    app.world().entity_mut(camera).insert((ambient, Exposure::INDOOR));
    camera
}

/// Light of the last frame has met several surfaces, as light in the truth of several bounces has.
#[test]
#[ignore = "long: large scenes and their truth"]
fn standard_scenes_stay_near_the_truth() {
    let size = STANDARD;
    let Some((tracer, mut app)) = apps(size, Output::Picture).last() else {
        return;
    };
    let camera = spawn_standard_scene(&mut app);
    let mut picture = |settings: RayTracedReflections, frames| {
        app.world().entity_mut(camera).insert(settings);
        app.step(2);
        warm_up(&mut app);
        app.world().resource_mut::<Time<Virtual>>().pause();
        app.step(frames);
        app.capture().unwrap()
    };
    let mut truth = |max_bounces| {
        let settings = RayTracedReflections {
            technique: ReflectionTechnique::Converged,
            max_bounces,
            bounce_roughness_cutoff: 1.0,
            ..default()
        };
        picture(settings, 96)
    };
    let truths = [1, 4].map(&mut truth);
    let mut errors = |screen_traces| {
        let settings = RayTracedReflections {
            screen_traces,
            denoiser: ReflectionDenoiser {
                converge_static_views: false,
                ..default()
            },
            ..default()
        };
        let picture = picture(settings, 48);
        dump(&format!("screen-standard-{screen_traces}"), size, &truths[1], &picture);
        truths.each_ref().map(|truth| flip(size, truth, &picture).0)
    };
    let [without, reused, marched] = ScreenTraces::ALL.map(&mut errors);
    println!(
        "{tracer:?}: mean FLIP to truths of 1 and 4 bounces {without:.5?} without, {reused:.5?} with reuse, {marched:.5?} with a march"
    );
    for with in [reused, marched] {
        assert!(with[1] < without[1] + MORE, "{with:?} is far above {without:?}");
    }
}
