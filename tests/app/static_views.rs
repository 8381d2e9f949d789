//! Views without a change converge, regardless of changes elsewhere; visible changes are followed at once.

use crate::{
    pictures::{apps, linear_app, use_coarse_shadow_maps},
    stage::{
        BEFORE_THE_MIRROR, SIZE, add, begin_anew, behind, cube_map, denoised, forward, frame, metal, settings_of,
        spawn_camera, spawn_mesh, texel, unlit_color, wall,
    },
};
use bevy::{
    camera::Exposure,
    image::Image,
    light::{Atmosphere, ClusteredDecal, LightProbe, SunDisk, atmosphere::ScatteringMedium},
    pbr::AtmosphereSettings,
    prelude::*,
};
use bevy_glint::{ReflectedParticle, ReflectedParticles, ReflectionTechnique, ReflectionTracerChoice};
use glint_scenes::{HeadlessApp, Output, SceneName};

/// Behind the reflecting wall, where rays don't reach.
const UNSEEN: Vec3 = Vec3::new(0.0, 0.0, -6.0);
/// Before it, and behind the camera.
const SEEN: Vec3 = Vec3::new(0.5, 0.0, 5.5);

/// cd/m^2 of the light probe around the object.
const PROBE: f32 = 2_500.0;

/// An object, its material and its texture, a lamp beside it and a light probe around it. Any of them can change.
struct Restless {
    at: Vec3,
    object: Entity,
    material: Handle<StandardMaterial>,
    texture: Handle<Image>,
    lamp: Entity,
    probe: Entity,
    map: Handle<Image>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Change {
    Nothing,
    Place,
    Color,
    Uv,
    Lamp,
    Image,
    Probe,
    /// The probe's map is repainted, and its texture stays the same.
    Repaint,
}

/// A light probe with a box large enough for the objects around it.
fn spawn_probe(app: &mut HeadlessApp, at: Vec3) -> (Entity, Handle<Image>) {
    let map = add(app, cube_map(1, vec![255; 24]));
    let probe = LightProbe {
        falloff: Vec3::splat(0.1),
    };
    let light = EnvironmentMapLight {
        diffuse_map: map.clone(),
        specular_map: map.clone(),
        intensity: PROBE,
        ..default()
    };
    let place = Transform::from_translation(at).with_scale(Vec3::splat(3.0));
    (app.world().spawn((probe, light, place)).id(), map)
}

impl Restless {
    fn spawn(app: &mut HeadlessApp, at: Vec3) -> Self {
        let object = Cuboid::new(0.6, 0.6, 0.1);
        let place = Transform::from_translation(at);
        let texture = add(app, texel([255; 3]));
        let material = StandardMaterial {
            base_color_texture: Some(texture.clone()),
            ..default()
        };
        let object = spawn_mesh(app, object, material, place);
        let lamp = PointLight {
            intensity: 60_000.0,
            range: 5.0,
            shadow_maps_enabled: true,
            ..default()
        };
        let lamp = app.world().spawn((lamp, Transform::from_translation(at - Vec3::Z)));
        let lamp = lamp.id();
        let material = app.world().get::<MeshMaterial3d<StandardMaterial>>(object).unwrap();
        let material = material.0.clone();
        let (probe, map) = spawn_probe(app, at);
        Self {
            at,
            object,
            material,
            texture,
            lamp,
            probe,
            map,
        }
    }

    fn restore(&self, app: &mut HeadlessApp) {
        let world = app.world();
        world.get_mut::<Transform>(self.object).unwrap().translation = self.at;
        world.get_mut::<PointLight>(self.lamp).unwrap().intensity = 60_000.0;
        let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
        materials.get_mut(&self.material).unwrap().base_color = Color::WHITE;
        self.paint(app, [255; 4]);
        self.paint_map(app, 255);
        self.set_probe(app, PROBE);
    }

    fn paint(&self, app: &mut HeadlessApp, color: [u8; 4]) {
        let mut images = app.world().resource_mut::<Assets<Image>>();
        images.get_mut(&self.texture).unwrap().data = Some(color.into());
    }

    fn paint_map(&self, app: &mut HeadlessApp, level: u8) {
        let mut images = app.world().resource_mut::<Assets<Image>>();
        images.get_mut(&self.map).unwrap().data = Some([level, level, level, 255].repeat(6));
    }

    fn set_probe(&self, app: &mut HeadlessApp, intensity: f32) {
        let mut light = app.world().get_mut::<EnvironmentMapLight>(self.probe).unwrap();
        light.intensity = intensity;
    }

    /// `step` counts frames.
    fn change(&self, app: &mut HeadlessApp, change: Change, step: u16) {
        let wave = (f32::from(step) * 0.7).sin();
        let world = app.world();
        match change {
            Change::Nothing => {}
            Change::Place => world.get_mut::<Transform>(self.object).unwrap().translation.x += 0.05 * wave,
            Change::Color => {
                let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
                materials.get_mut(&self.material).unwrap().base_color = Color::linear_rgb(0.5 + 0.4 * wave, 0.1, 0.9);
            }
            Change::Uv => {
                let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
                materials.get_mut(&self.material).unwrap().uv_transform.translation = Vec2::splat(wave);
            }
            Change::Lamp => world.get_mut::<PointLight>(self.lamp).unwrap().intensity = 60_000.0 + 40_000.0 * wave,
            Change::Image => self.paint(app, [(128.0 + 100.0 * wave) as u8, 20, 230, 255]),
            Change::Repaint => self.paint_map(app, (128.0 + 100.0 * wave) as u8),
            Change::Probe => self.set_probe(app, PROBE * (1.0 + 0.9 * wave)),
        }
    }
}

/// A rough wall of metal, which reflects a lit room behind the camera.
pub fn room(app: &mut HeadlessApp, roughness: f32) -> Entity {
    use_coarse_shadow_maps(app);
    spawn_mesh(app, wall(), metal(roughness), Transform::IDENTITY);
    spawn_mesh(app, wall(), Color::WHITE.into(), behind(7.0));
    for x in [-1.5, 1.5] {
        let place = Transform::from_xyz(x, 0.5, 5.0);
        spawn_mesh(app, Cuboid::from_length(1.0), Color::BLACK.into(), place);
    }
    let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::Demo);
    let settings = denoised(ReflectionTechnique::Reference);
    app.world().entity_mut(camera).insert(settings);
    camera
}

pub fn capture(app: &mut HeadlessApp) -> Vec<f32> {
    let pixels = app.capture_linear().unwrap();
    pixels.into_iter().map(|[_, green, ..]| green).collect()
}

/// Mean difference relative to the mean of the first image.
pub fn difference(a: &[f32], b: &[f32]) -> f32 {
    let sum: f32 = a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum();
    sum / a.iter().sum::<f32>()
}

/// Renders frames from a new beginning on, and returns by how much the last images differ from frame to frame. `before` is called
/// before each frame.
fn noise(app: &mut HeadlessApp, camera: Entity, mut before: impl FnMut(&mut HeadlessApp, u16)) -> f32 {
    begin_anew(app, camera);
    let mut images = Vec::new();
    for step in 0..90 {
        before(app, step);
        frame(app);
        if step >= 86 {
            images.push(capture(app));
        }
    }
    let differences = images.windows(2).map(|pair| difference(&pair[0], &pair[1]));
    differences.sum::<f32>() / 3.0
}

#[test]
#[ignore = "long: hundreds of frames"]
fn what_no_ray_meets_keeps_no_view_from_converging() {
    let Some(mut app) = linear_app(SIZE) else { return };
    let app = &mut app;
    let restless = Restless::spawn(app, UNSEEN);
    let camera = room(app, 0.5);
    // Until objects are merged, too.
    begin_anew(app, camera);
    (0..150).for_each(|_| frame(app));
    let changes = [
        Change::Nothing,
        Change::Place,
        Change::Color,
        Change::Uv,
        Change::Lamp,
        Change::Image,
        Change::Probe,
    ];
    let noise = changes.map(|change| {
        // The beginning of a movement is a change for all views, so histories are equally long in all cases.
        (0..40).for_each(|_| frame(app));
        app.world().get_mut::<Transform>(restless.object).unwrap().translation.y += 0.1;
        let noise = noise(app, camera, |app, step| restless.change(app, change, step));
        println!("{change:?}: images differ by {noise:.5} from frame to frame");
        noise
    });
    // Noise is at least 1.5 times as high in a view that doesn't count as static.
    let [still, changing @ ..] = noise;
    assert!(
        still > 0.0 && changing.iter().all(|noise| *noise < 1.2 * still),
        "{noise:?}"
    );
}

/// Apps write particles in each frame, whether they have changed or not.
#[test]
#[ignore = "long: hundreds of frames"]
fn particles_that_are_written_again_keep_no_view_from_converging() {
    let Some(mut app) = linear_app(SIZE) else { return };
    let app = &mut app;
    let camera = room(app, 0.5);
    let material = add(app, unlit_color(Color::WHITE));
    let particles = vec![ReflectedParticle {
        position: SEEN,
        ..default()
    }];
    let particles = app.world().spawn(ReflectedParticles { particles, material }).id();
    begin_anew(app, camera);
    (0..150).for_each(|_| frame(app));
    let [left_alone, written, moved] = [None, Some(0.0), Some(1e-4)].map(|step| {
        noise(app, camera, |app, _| {
            if let Some(step) = step {
                let mut all = app.world().get_mut::<ReflectedParticles>(particles).unwrap();
                all.particles[0].position.x += step;
            }
        })
    });
    println!("noise {left_alone} alone, {written} written again, {moved} moved");
    assert!(
        left_alone > 0.0 && written < 1.2 * left_alone,
        "{written} and {left_alone}"
    );
    assert!(moved > 1.3 * left_alone, "{moved} and {left_alone}");
}

/// Compares the remaining error some frames after a change, between views that converge before it and views that never do. `restore`
/// undoes the change. `advance` gets the step, and whether to make the change.
fn assert_followed(
    app: &mut HeadlessApp,
    camera: Entity,
    name: &str,
    restore: impl Fn(&mut HeadlessApp),
    advance: impl Fn(&mut HeadlessApp, u16, bool),
) {
    let set_converging = |app: &mut HeadlessApp, converges: bool| {
        settings_of(app, camera).denoiser.converge_static_views = converges;
    };
    let [without, with] = [false, true].map(|converges| {
        restore(app);
        set_converging(app, converges);
        begin_anew(app, camera);
        for step in 0..80 {
            advance(app, step, false);
            frame(app);
        }
        let before = capture(app);
        for step in 0..16 {
            advance(app, step, true);
            frame(app);
        }
        [before, capture(app)]
    });
    // The truth for both, of views that converge.
    begin_anew(app, camera);
    (0..80).for_each(|_| frame(app));
    let truth = capture(app);
    let [without, with] = [(false, without), (true, with)].map(|(converges, images)| {
        let [changed, left] = images.map(|image| difference(&truth, &image));
        println!("{name}, converges: {converges}: {changed:.4} before, {left:.4} after 16 frames");
        left
    });
    assert!(
        with < 1.2 * without,
        "{name}: {with} where views converge, {without} where not"
    );
}

#[test]
#[ignore = "long: hundreds of frames for each kind of change"]
fn what_rays_meet_is_followed() {
    let all = [
        Change::Place,
        Change::Color,
        Change::Lamp,
        Change::Image,
        Change::Probe,
        Change::Repaint,
    ];
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        let unseen = Restless::spawn(app, UNSEEN);
        let seen = Restless::spawn(app, SEEN);
        let camera = room(app, 0.2);
        let only_images = tracer == ReflectionTracerChoice::RayQuery;
        let once = if only_images { &[Change::Image][..] } else { &all };
        let once = once.iter().map(|change| (*change, 1));
        // Over several bounces every motion is a change for all views, since only that keeps them from converging.
        for (change, bounces) in once.chain([(Change::Image, 2)]) {
            settings_of(app, camera).max_bounces = bounces;
            let name = format!("{tracer}, {change:?}, bounces: {bounces}");
            let restore = |app: &mut HeadlessApp| seen.restore(app);
            assert_followed(app, camera, &name, restore, |app, step, happens| {
                if bounces == 1 {
                    unseen.change(app, Change::Place, step);
                }
                if happens {
                    // To one side, or to the darkest.
                    seen.change(app, change, if change == Change::Place { 2 } else { 7 });
                }
            });
        }
    }
}

/// No surface has a mark for its decals.
#[test]
#[ignore = "long: hundreds of frames"]
fn decals_that_appear_are_followed() {
    let Some(mut app) = linear_app(SIZE) else { return };
    let app = &mut app;
    let camera = room(app, 0.2);
    let thing = forward(default());
    spawn_mesh(app, Cuboid::from_length(1.5), thing, Transform::from_translation(SEEN));
    let glow = add(app, texel([255; 3]));
    let decal = ClusteredDecal {
        emissive_texture: Some(glow),
        ..default()
    };
    let place = Transform::from_translation(SEEN).with_scale(Vec3::splat(2.0));
    let decal = app.world().spawn((decal, place, Visibility::Hidden)).id();
    let show = |app: &mut HeadlessApp, visibility| {
        app.world().entity_mut(decal).insert(visibility);
    };
    let restore = |app: &mut HeadlessApp| show(app, Visibility::Hidden);
    assert_followed(app, camera, "a decal", restore, |app, _, happens| {
        if happens {
            show(app, Visibility::Visible);
        }
    });
}

/// Units per metre: haze of kilometres between objects that are near.
const METRE: f32 = 0.001;

/// Air around a rough mirror, which shows the sky and an object without sunlight: no surface that rays hit has the sun's mark.
fn spawn_in_air(app: &mut HeadlessApp) -> (Entity, Entity) {
    spawn_mesh(app, wall(), metal(0.2), Transform::IDENTITY);
    let thing = unlit_color(Color::linear_rgb(0.1, 0.3, 0.8));
    spawn_mesh(app, Sphere::new(1.5), thing, Transform::from_xyz(-1.0, 0.0, 8.0));
    let medium = add(app, ScatteringMedium::earth(64, 64));
    let atmosphere = Atmosphere::earth(medium);
    let depth = (atmosphere.inner_radius + 1_500.0) * METRE;
    let place = Transform::from_xyz(0.0, -depth, 0.0).with_scale(Vec3::splat(METRE));
    app.world().spawn((atmosphere, place));
    let sun = (DirectionalLight::default(), SunDisk::OFF, Transform::default());
    let sun = app.world().spawn(sun).id();
    let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
    app.world().entity_mut(camera).insert((
        AtmosphereSettings::default(),
        Exposure::default(),
        denoised(ReflectionTechnique::Reference),
    ));
    (camera, sun)
}

#[test]
#[ignore = "long: hundreds of frames of a sky"]
fn the_sun_of_an_atmosphere_is_followed() {
    const NOON: Vec3 = Vec3::new(1.0, -2.0, 0.5);
    const EVENING: Vec3 = Vec3::new(1.0, -0.05, 0.5);
    let Some(mut app) = linear_app(SIZE) else { return };
    let app = &mut app;
    let (camera, sun) = spawn_in_air(app);
    let shine = |app: &mut HeadlessApp, illuminance: f32, direction: Vec3| {
        let mut sun = app.world().entity_mut(sun);
        sun.get_mut::<DirectionalLight>().unwrap().illuminance = illuminance;
        *sun.get_mut::<Transform>().unwrap() = Transform::default().looking_to(direction, Vec3::Y);
    };
    let morning = |app: &mut HeadlessApp| shine(app, 6_000.0, NOON);
    for (name, illuminance, direction) in [("illuminance", 2_000.0, NOON), ("direction", 6_000.0, EVENING)] {
        assert_followed(app, camera, name, morning, |app, step, happens| {
            if happens && step == 0 {
                shine(app, illuminance, direction);
            }
        });
    }
}

/// Fog is a component of the camera, and rays don't hit it.
#[test]
fn the_ground_truth_begins_anew_with_the_fog() {
    const FRAMES: u32 = 24;
    let Some(mut app) = linear_app(SIZE) else { return };
    let app = &mut app;
    let camera = room(app, 0.2);
    settings_of(app, camera).technique = ReflectionTechnique::Converged;
    begin_anew(app, camera);
    (0..FRAMES).for_each(|_| frame(app));
    let clear = capture(app);
    app.world().entity_mut(camera).insert(DistanceFog {
        color: Color::linear_rgb(0.1, 2.0, 0.1),
        falloff: FogFalloff::Linear { start: 6.0, end: 9.0 },
        ..default()
    });
    (0..FRAMES).for_each(|_| frame(app));
    let foggy = capture(app);
    begin_anew(app, camera);
    (0..FRAMES).for_each(|_| frame(app));
    let truth = capture(app);
    let (changed, left) = (difference(&truth, &clear), difference(&truth, &foggy));
    println!("fog changes the picture by {changed:.3}, of which {left:.4} are left");
    assert!(changed > 0.1 && left < 0.1 * changed, "{changed}, {left}");
}
