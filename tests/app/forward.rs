//! Reflections on opaque surfaces that Bevy draws forward.

use crate::{
    pictures::{apps, apps_with, reflect},
    stage::{
        BEFORE_THE_MIRROR, BLUE, GREEN, RED, SIZE, Unprepared, WithoutPrepass, add, before, begin_anew, behind, clear,
        clear_glass, edit_material, forward, frame, layer_bytes, metal, settings_of, sheet, spawn_behind, spawn_camera,
        spawn_mesh, spawn_of, unlit,
    },
};
use bevy::{
    camera::visibility::RenderLayers,
    light::LightProbe,
    material::OpaqueRendererMethod,
    pbr::{DefaultOpaqueRendererMethod, ExtendedMaterial, MaterialExtension, ScreenSpaceAmbientOcclusion},
    prelude::*,
    render::render_resource::AsBindGroup,
};
use bevy_glint::{
    NotReflected, RayTracedReflections, ReflectedMaterial3d, ReflectedMaterialPlugin, ReflectionTechnique,
};
use glint_scenes::{HeadlessApp, Output, SceneName};

type Picture = Vec<[f32; 4]>;

/// A red wall behind the camera, a green one to its right and a blue cube to its left.
fn spawn_surroundings(app: &mut HeadlessApp, around: Transform) {
    for (color, at) in [
        (RED, behind(9.0)),
        (GREEN, Transform::from_xyz(8.0, 0.0, 0.0).looking_to(Vec3::X, Vec3::Y)),
    ] {
        spawn_mesh(app, Rectangle::new(12.0, 12.0), unlit(color), around * at);
    }
    let at = around * Transform::from_xyz(-3.0, 0.5, 1.0);
    spawn_mesh(app, Cuboid::from_length(1.5), unlit(BLUE), at);
}

fn draw(app: &mut HeadlessApp, object: Entity, method: OpaqueRendererMethod) {
    edit_material(app, object, |material| material.opaque_render_method = method);
}

fn settle(app: &mut HeadlessApp, camera: Entity, frames: u32) -> Picture {
    app.step(2);
    begin_anew(app, camera);
    app.step(frames);
    app.capture_linear().unwrap()
}

fn set_forward(app: &mut HeadlessApp, camera: Entity, forward: bool) {
    app.world().get_mut::<RayTracedReflections>(camera).unwrap().forward = forward;
}

/// Mean difference of two images, and the fraction of pixels that differ by more than a twentieth.
fn apart(a: &Picture, b: &Picture) -> (f32, f32) {
    let apart = |a: &[f32; 4], b: &[f32; 4]| (Vec3::from_slice(a) - Vec3::from_slice(b)).abs().max_element();
    let differences: Vec<f32> = a.iter().zip(b).map(|(a, b)| apart(a, b)).collect();
    let count = differences.len() as f32;
    let far = differences.iter().filter(|difference| **difference > 0.05).count();
    (differences.iter().sum::<f32>() / count, far as f32 / count)
}

/// Images of the same object drawn deferred, drawn forward, and drawn forward without traced reflections.
fn compare(app: &mut HeadlessApp, camera: Entity, object: Entity, frames: u32) -> [Picture; 3] {
    draw(app, object, OpaqueRendererMethod::Deferred);
    let deferred = settle(app, camera, frames);
    draw(app, object, OpaqueRendererMethod::Forward);
    let forward = settle(app, camera, frames);
    set_forward(app, camera, false);
    // Much further off than any noise.
    let without = settle(app, camera, frames.min(4));
    set_forward(app, camera, true);
    [deferred, forward, without]
}

/// One material looks the same drawn in both ways.
#[test]
fn forward_surfaces_reflect_as_deferred_ones() {
    use ReflectionTechnique::{Converged, Reference, Variable};
    let base = Color::srgb(0.9, 0.7, 0.4);
    let gold = |perceptual_roughness| StandardMaterial {
        base_color: base,
        ..metal(perceptual_roughness)
    };
    let plastic = StandardMaterial {
        base_color: Color::srgb(0.1, 0.1, 0.1),
        perceptual_roughness: 0.2,
        reflectance: 0.9,
        ..default()
    };
    let masked = StandardMaterial {
        alpha_mode: AlphaMode::Mask(0.5),
        ..gold(0.0)
    };
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        for (surroundings, technique, material, frames, limit) in [
            (SceneName::MirrorRoom, Reference, gold(0.0), 4, 0.002),
            (SceneName::Furnace, Reference, gold(0.0), 4, 0.002),
            (SceneName::Furnace, Variable, gold(0.0), 4, 0.002),
            (SceneName::Furnace, Reference, masked.clone(), 4, 0.002),
            (SceneName::Furnace, Converged, gold(0.5), 24, 0.002),
            (SceneName::Furnace, Converged, plastic.clone(), 24, 0.002),
        ] {
            let camera = spawn_camera(app, BEFORE_THE_MIRROR, surroundings);
            spawn_surroundings(app, Transform::IDENTITY);
            let object = spawn_mesh(app, Sphere::new(1.0), material.clone(), Transform::IDENTITY);
            reflect(app, camera, technique);
            // Rays that pixels share are sampled again in each layer.
            settings_of(app, camera).full_resolution_mirrors = true;
            let [deferred, forward, without] = compare(app, camera, object, frames);
            let (mean, far) = apart(&deferred, &forward);
            let (blank, _) = apart(&deferred, &without);
            println!("{tracer:?}, {surroundings:?}, {technique:?}: {mean:.5}, {far:.4} far; {blank:.5} without");
            let roughness = material.perceptual_roughness;
            assert!(blank > 4.0 * limit, "{tracer:?}, {technique:?}, {roughness}: {blank}");
            assert!(
                mean < limit && far < 0.02,
                "{tracer:?}, {technique:?}, {roughness}: {mean}, {far}"
            );
            clear(app);
        }
    }
}

/// Places and cameras at which depth and hits differ most.
#[test]
fn depth_and_hits_agree_far_away_and_in_parallel() {
    let parallel = Projection::Orthographic(OrthographicProjection {
        scale: 0.05,
        ..OrthographicProjection::default_3d()
    });
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        for (name, around, scale, projection) in [
            ("at 5 km", Vec3::new(5000.0, -3000.0, 4000.0), 1.0, None),
            ("large", Vec3::ZERO, 300.0, None),
            ("parallel", Vec3::ZERO, 1.0, Some(parallel.clone())),
        ] {
            let mut at = BEFORE_THE_MIRROR;
            at.translation = around + Vec3::new(0.0, 0.0, 3.0 * scale);
            let camera = spawn_camera(app, at, SceneName::MirrorRoom);
            let occlusion = ScreenSpaceAmbientOcclusion::default();
            app.world().entity_mut(camera).insert(occlusion);
            if let Some(projection) = projection {
                app.world().entity_mut(camera).insert(projection);
            }
            let place = Transform::from_translation(around).with_scale(Vec3::splat(scale));
            spawn_surroundings(app, place);
            let object = spawn_mesh(app, Sphere::new(1.0), metal(0.0), place);
            // At grazing angles, with something to reflect.
            let sheet = place * Transform::from_xyz(0.0, 0.0, -6.0);
            spawn_mesh(app, Rectangle::new(12.0, 12.0), unlit(BLUE), sheet);
            let mesh = Plane3d::default().mesh().size(40.0, 40.0);
            let floor = spawn_mesh(app, mesh, metal(0.0), place * Transform::from_xyz(0.0, -1.0, 0.0));
            reflect(app, camera, ReflectionTechnique::Reference);
            for (part, object) in [("sphere", object), ("floor", floor)] {
                let [deferred, forward, without] = compare(app, camera, object, 4);
                let (mean, far) = apart(&deferred, &forward);
                let (blank, _) = apart(&deferred, &without);
                println!("{tracer:?}, {name}, {part}: {mean:.5}, {far:.4} far; {blank:.5} without");
                assert!(blank > 0.01, "{tracer:?}, {name}, {part}: {blank}");
                assert!(mean < 0.004 && far < 0.02, "{tracer:?}, {name}, {part}: {mean}, {far}");
            }
            clear(app);
        }
    }
}

/// A moving surface keeps its history, as a deferred one does.
#[test]
#[ignore = "long: frames of noise"]
fn moving_forward_surfaces_have_no_more_noise() {
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
        spawn_surroundings(app, Transform::IDENTITY);
        let object = spawn_mesh(app, Sphere::new(1.0), metal(0.4), Transform::IDENTITY);
        reflect(app, camera, ReflectionTechnique::Converged);
        let truth = settle(app, camera, 256);
        let error = |app: &mut HeadlessApp, method| {
            draw(app, object, method);
            reflect(app, camera, ReflectionTechnique::Variable);
            app.world().get_mut::<RayTracedReflections>(camera).unwrap().denoiser = default();
            settle(app, camera, 4);
            for step in (0..=24).rev() {
                let at = Transform::from_xyz(0.01 * step as f32, 0.0, 0.0);
                app.world().entity_mut(object).insert(at);
                app.step(1);
            }
            apart(&truth, &app.capture_linear().unwrap()).0
        };
        let deferred = error(app, OpaqueRendererMethod::Deferred);
        let forward = error(app, OpaqueRendererMethod::Forward);
        println!("{tracer:?}: {deferred:.5} deferred, {forward:.5} forward");
        assert!(
            deferred > 0.0 && forward < 1.2 * deferred,
            "{tracer:?}: {deferred}, {forward}"
        );
    }
}

fn center(app: &HeadlessApp) -> Vec3 {
    let size = app.size();
    let middle = (size.y / 2 * size.x + size.x / 2) as usize;
    Vec3::from_slice(&app.capture_linear().unwrap()[middle])
}

/// Glass in front of it wins, a deferred object hides it, and objects that rays don't see don't reflect for the surfaces behind them.
#[test]
fn what_stands_before_a_forward_surface_comes_first() {
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
        spawn_mesh(app, sheet(), forward(metal(0.0)), before(4.0));
        spawn_behind(app, RED);
        reflect(app, camera, ReflectionTechnique::Reference);
        let on = |app: &mut HeadlessApp| {
            settle(app, camera, 4);
            center(app)
        };
        let alone = on(app);
        assert!(alone.x > 0.95 && alone.y < 0.05, "{tracer:?}: {alone}");

        let pane = spawn_mesh(app, sheet(), clear_glass(), before(2.0));
        let with_pane = on(app);
        set_forward(app, camera, false);
        let pane_alone = on(app);
        assert_eq!(with_pane, pane_alone, "{tracer:?}");
        assert!((pane_alone.x - 0.16).abs() < 0.01, "{tracer:?}: {pane_alone}");
        // Without reflections of its own, it is drawn over the reflections of the metal.
        set_forward(app, camera, true);
        app.world().get_mut::<RayTracedReflections>(camera).unwrap().transparent = false;
        let under = on(app);
        assert!((under - alone).abs().max_element() < 1e-3, "{tracer:?}: {under}");
        app.world().get_mut::<RayTracedReflections>(camera).unwrap().transparent = true;
        app.world().despawn(pane);
        assert!((on(app) - alone).abs().max_element() < 1e-3, "{tracer:?}");

        // Smoke that has no place in the layer dims them.
        let smoke = StandardMaterial {
            base_color: Color::BLACK.with_alpha(0.75),
            unlit: true,
            alpha_mode: AlphaMode::Blend,
            ..default()
        };
        let smoke = spawn_mesh(app, sheet(), smoke, before(2.0));
        let through = on(app);
        assert!((through.x / alone.x - 0.25).abs() < 0.01, "{tracer:?}: {through}");
        app.world().despawn(smoke);

        for (name, material, is_known) in [
            ("deferred, unlit", unlit(GREEN), true),
            ("forward, unlit", forward(unlit(GREEN)), true),
            ("forward, unlit, unknown to rays", forward(unlit(GREEN)), false),
        ] {
            // 20 mm in front of the surface, which is 4 m away.
            let object = spawn_mesh(app, Rectangle::new(2.0, 2.0), material, before(3.98));
            if !is_known {
                app.world().entity_mut(object).insert(NotReflected);
            }
            let shown = on(app);
            assert!(shown.x < 1e-3 && shown.y > 0.99, "{tracer:?}, {name}: {shown}");
            app.world().despawn(object);
        }
        // A camera that doesn't draw it, and one that does.
        let world = app.world();
        world.entity_mut(camera).insert(RenderLayers::from_layers(&[0, 1]));
        let object = spawn_mesh(app, sheet(), forward(metal(0.0)), before(3.0));
        app.world().entity_mut(object).insert(RenderLayers::layer(1));
        assert!(on(app).x > 0.95, "{tracer:?}");
        app.world().entity_mut(camera).insert(RenderLayers::layer(0));
        assert!(on(app).x > 0.95, "{tracer:?}");
    }
}

/// The depth of the prepass lacks objects without a prepass, but such an object hides the surfaces behind it.
#[test]
fn objects_without_a_prepass_cover_reflections() {
    let plugins = |app: &mut App| _ = app.add_plugins(MaterialPlugin::<Unprepared>::default());
    for (tracer, mut app) in apps_with(SIZE, Output::Linear, plugins) {
        let app = &mut app;
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
        spawn_mesh(app, sheet(), forward(metal(0.0)), before(4.0));
        spawn_behind(app, RED);
        let (base, extension) = (forward(unlit(GREEN)), WithoutPrepass {});
        let material = Unprepared { base, extension };
        let object = spawn_of(app, Rectangle::new(1.5, 1.5), material, Transform::default());
        reflect(app, camera, ReflectionTechnique::Reference);
        let mut on = |distance: f32| {
            app.world().entity_mut(object).insert(before(distance));
            let picture = settle(app, camera, 4);
            let colors = picture.iter().map(|pixel| Vec3::from_slice(pixel));
            let count = |test: fn(&Vec3) -> bool| colors.clone().filter(test).count();
            let red = count(|color| color.x > 0.95 && color.y < 0.05);
            let green = count(|color| color.x < 1e-3 && color.y > 0.99);
            println!("{tracer:?}, at {distance} m: {red} red pixels, {green} green");
            (red, green)
        };
        let all = (SIZE.x * SIZE.y) as usize;
        assert_eq!(on(5.0), (all, 0), "{tracer:?}: behind the wall");
        for distance in [3.0, 3.99] {
            let (red, green) = on(distance);
            assert!(green > 200 && red > 200, "{tracer:?}: {red}, {green}");
            assert_eq!(red + green, all, "{tracer:?}: red shines through green");
        }
    }
}

/// With reflections off, the image equals the one without reflections bit for bit. Without forward objects on the screen, no
/// memory is allocated.
#[test]
fn without_forward_surfaces_nothing_is_held() {
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::Furnace);
        let sheet = spawn_mesh(app, sheet(), metal(0.0), before(4.0));
        spawn_surroundings(app, Transform::IDENTITY);
        reflect(app, camera, ReflectionTechnique::Reference);
        settle(app, camera, 4);
        assert_eq!(layer_bytes(app), 0, "{tracer:?}");
        draw(app, sheet, OpaqueRendererMethod::Forward);
        let on = settle(app, camera, 4);
        assert!(layer_bytes(app) > 0, "{tracer:?}");
        set_forward(app, camera, false);
        (0..70).for_each(|_| frame(app));
        assert_eq!(layer_bytes(app), 0, "{tracer:?}");
        let off = settle(app, camera, 4);
        app.world().entity_mut(camera).remove::<RayTracedReflections>();
        app.step(4);
        let plain = app.capture_linear().unwrap();
        assert!(off == plain, "{tracer:?}: {:?}", apart(&off, &plain));
        assert!(apart(&on, &plain).0 > 0.1, "{tracer:?}");

        reflect(app, camera, ReflectionTechnique::Reference);
        settle(app, camera, 4);
        assert!(layer_bytes(app) > 0, "{tracer:?}");
        app.world().entity_mut(sheet).insert(before(-100.0));
        (0..70).for_each(|_| frame(app));
        assert_eq!(layer_bytes(app), 0, "{tracer:?}: out of sight");
        app.world().entity_mut(sheet).insert(before(4.0));
        assert!(settle(app, camera, 4) == on, "{tracer:?}");
        assert!(layer_bytes(app) > 0, "{tracer:?}");
        edit_material(app, sheet, |material| material.unlit = true);
        (0..70).for_each(|_| frame(app));
        assert_eq!(layer_bytes(app), 0, "{tracer:?}: unlit");
    }
}

/// `deferred_by_default` isn't needed, and rays replace probes.
#[test]
fn an_app_that_draws_everything_forward_has_reflections() {
    for (tracer, mut app) in apps(SIZE, Output::Linear) {
        let app = &mut app;
        app.world().insert_resource(DefaultOpaqueRendererMethod::forward());
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::Furnace);
        spawn_mesh(app, sheet(), metal(0.0), before(4.0));
        spawn_behind(app, RED);
        reflect(app, camera, ReflectionTechnique::Variable);
        settle(app, camera, 4);
        let shown = center(app);
        assert!(shown.x > 0.9 && shown.yz().max_element() < 0.05, "{tracer:?}: {shown}");
        let map = app.world().get::<EnvironmentMapLight>(camera).unwrap().clone();
        app.world().spawn((
            LightProbe { falloff: Vec3::ZERO },
            EnvironmentMapLight {
                intensity: 2000.0,
                ..map
            },
            Transform::from_scale(Vec3::splat(30.0)),
        ));
        settle(app, camera, 4);
        let shown = center(app);
        assert!(shown.x > 0.9 && shown.yz().max_element() < 0.05, "{tracer:?}: {shown}");
    }
}

/// An extension with a plugin without settings.
#[derive(Asset, AsBindGroup, Reflect, Clone, Default)]
struct Lacquer {
    #[uniform(100)]
    depth: Vec4,
}

impl MaterialExtension for Lacquer {}

/// An extension whose plugin declares that it shows no environment.
#[derive(Asset, AsBindGroup, Reflect, Clone, Default)]
struct Toon {
    #[uniform(100)]
    tones: Vec4,
}

impl MaterialExtension for Toon {}

type Extended<E> = ExtendedMaterial<StandardMaterial, E>;

/// A sheet that hides the right half of the one behind it.
fn spawn_half<M: Material>(app: &mut HeadlessApp, material: M) -> Entity {
    let at = before(3.5) * Transform::from_xyz(10.0, 0.0, 0.0);
    spawn_of(app, Rectangle::new(20.0, 40.0), material, at)
}

/// Light in the middle of the left and of the right half.
fn halves(app: &HeadlessApp) -> [Vec3; 2] {
    let size = app.size();
    let picture = app.capture_linear().unwrap();
    [1, 3].map(|quarter| Vec3::from_slice(&picture[(size.y / 2 * size.x + quarter * size.x / 4) as usize]))
}

/// Rays add nothing for materials that don't show the environment, or for materials with a stand-in, since stand-ins only describe
/// surfaces to rays.
#[test]
fn materials_without_environment_and_stand_ins_look_as_ever() {
    let plugins = |app: &mut App| {
        app.add_plugins((
            MaterialPlugin::<Extended<Lacquer>>::default(),
            MaterialPlugin::<Extended<Toon>>::default(),
            ReflectedMaterialPlugin::<Extended<Lacquer>>::default(),
            ReflectedMaterialPlugin::<Extended<Toon>>::without_environment(),
            // Adding it twice changes nothing.
            ReflectedMaterialPlugin::<Extended<Toon>>::default(),
        ));
    };
    for (tracer, mut app) in apps_with(SIZE, Output::Linear, plugins) {
        let app = &mut app;
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::Furnace);
        spawn_behind(app, RED);
        let base = forward(metal(0.0));
        spawn_mesh(app, sheet(), base.clone(), before(4.0));
        reflect(app, camera, ReflectionTechnique::Reference);
        let is_red = |light: Vec3| light.x > 0.9 && light.yz().max_element() < 0.05;
        let shown = |app: &mut HeadlessApp, name: &str| {
            set_forward(app, camera, true);
            settle(app, camera, 4);
            let [left, right] = halves(app);
            assert!(is_red(left), "{tracer:?}, beside {name}: {left}");
            set_forward(app, camera, false);
            settle(app, camera, 4);
            let [dull, plain] = halves(app);
            assert!(!is_red(dull) && !is_red(plain), "{tracer:?}, {name}: {dull}, {plain}");
            (right, plain)
        };

        let lacquer = Extended {
            base: base.clone(),
            extension: Lacquer::default(),
        };
        let lacquer = spawn_half(app, lacquer);
        let (light, _) = shown(app, "lacquer");
        assert!(is_red(light), "{tracer:?}: {light}");
        let stand_in = add(app, base.clone());
        app.world().entity_mut(lacquer).insert(ReflectedMaterial3d(stand_in));
        let (light, plain) = shown(app, "a stand-in");
        assert_eq!(light, plain, "{tracer:?}: a stand-in");
        app.world().entity_mut(lacquer).remove::<ReflectedMaterial3d>();
        let (light, _) = shown(app, "lacquer again");
        assert!(is_red(light), "{tracer:?}: {light}");
        app.world().despawn(lacquer);

        let extension = Toon::default();
        let toon = Extended { base, extension };
        spawn_half(app, toon);
        let (light, plain) = shown(app, "toon");
        assert_eq!(light, plain, "{tracer:?}: toon");
    }
}
