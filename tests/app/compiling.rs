//! The reflections that are shown while shaders compile, and the shaders that are compiled.

use crate::{
    common::app,
    pictures::{PATIENCE, apps, warm_up},
    stage::{
        BEFORE_THE_MIRROR, BLUE, GREEN, RED, SIZE, add, behind, clear, forward, metal, report, spawn_mesh,
        spawn_mirror, texel, unlit, wall,
    },
};
use bevy::{
    camera::Hdr,
    core_pipeline::tonemapping::Tonemapping,
    image::Image,
    light::{FogVolume, RectLight, VolumetricFog},
    pbr::Lightmap,
    prelude::*,
    render::render_resource::{CachedPipelineState, PipelineCache, PipelineDescriptor},
};
use bevy_glint::{RayTracedReflections, RayTracedReflectionsPlugin, ReflectionTechnique, ReflectionTracerChoice};
use glint_scenes::{HeadlessApp, HeadlessSettings, Output, SceneName, Sky};
use std::{
    collections::HashSet,
    time::{Duration, Instant},
};

/// Labels and definitions of the library's compute pipelines.
fn pipelines(app: &HeadlessApp) -> Vec<(String, Vec<String>)> {
    let cache = app.render_world().unwrap().resource::<PipelineCache>();
    let computes = cache.pipelines().filter_map(|pipeline| match &pipeline.descriptor {
        PipelineDescriptor::ComputePipelineDescriptor(compute) => Some(compute),
        _ => None,
    });
    let own = computes.filter_map(|compute| {
        let label = compute.label.as_deref().filter(|label| label.starts_with("glint_"))?;
        let mut defs: Vec<String> = compute.shader_defs.iter().map(|def| format!("{def:?}")).collect();
        defs.extend(compute.constants.iter().map(|constant| format!("{constant:?}")));
        defs.sort();
        Some((label.to_owned(), defs))
    });
    own.collect()
}

fn count(app: &HeadlessApp, label: &str) -> usize {
    pipelines(app).iter().filter(|(found, _)| found == label).count()
}

fn clearcoated() -> StandardMaterial {
    StandardMaterial {
        clearcoat: 1.0,
        ..default()
    }
}

/// A camera with these settings before a mirror and before coloured glass, which has its own variants.
fn stage(app: &mut HeadlessApp, settings: RayTracedReflections) -> Entity {
    let camera = spawn_mirror(app, 0.0, SceneName::Demo);
    let glass = StandardMaterial {
        base_color: Color::srgba(0.2, 0.8, 0.2, 0.5),
        specular_transmission: 0.5,
        ..default()
    };
    spawn_mesh(app, Sphere::new(0.5), glass, Transform::from_xyz(-1.0, 0.0, 6.0));
    app.world().entity_mut(camera).insert(settings);
    warm_up(app);
    camera
}

#[test]
fn nothing_is_compiled_twice_or_for_techniques_that_are_out_of_use() {
    for (tracer, mut app) in apps(SIZE, Output::Picture) {
        // Before much moves for the first time.
        app.step(2);
        let kernels = if tracer == ReflectionTracerChoice::Bvh { 3 } else { 2 };
        assert_eq!(
            count(&app, "glint_scatter"),
            kernels,
            "{tracer:?}: instances, lights, and the BVH's trees"
        );
        let camera = stage(&mut app, RayTracedReflections::default());
        let compiled = pipelines(&app);
        println!("{tracer:?}: {} pipelines at start", compiled.len());
        let different: HashSet<_> = compiled.iter().collect();
        assert_eq!(different.len(), compiled.len(), "{tracer:?}: {compiled:#?}");

        let settings = |technique| RayTracedReflections { technique, ..default() };
        app.world()
            .entity_mut(camera)
            .insert(settings(ReflectionTechnique::Converged));
        warm_up(&mut app);
        let converged = count(&app, "glint_trace_converged");
        assert!(converged > 0, "{tracer:?}");
        app.world().entity_mut(camera).insert(RayTracedReflections::default());
        warm_up(&mut app);
        let rays = count(&app, "glint_shade_hits") + count(&app, "glint_shade_hits_and_mirrors");
        let at = Transform::from_xyz(1.0, 0.0, 6.0);
        spawn_mesh(&mut app, Sphere::new(0.5), clearcoated(), at);
        warm_up(&mut app);
        assert_eq!(count(&app, "glint_trace_converged"), converged, "{tracer:?}");
        let now = count(&app, "glint_shade_hits") + count(&app, "glint_shade_hits_and_mirrors");
        assert!(now > rays, "{tracer:?}: the technique in use gets the feature");
        clear(&mut app);
    }
}

/// Most pipelines of the library: at the start of a view (three of them scatter changes), and those that the first glass and the first
/// fog add. Three of the last ones follow changes of the light.
const MOST_PIPELINES: [usize; 3] = [15, 6, 6];

/// Prints numbers of pipelines, and the time until they are compiled.
#[test]
#[ignore = "long: the CPU driver takes half a minute for rays through fog"]
fn features_compile_no_more_than_the_passes_that_see_them() {
    for tracer in [ReflectionTracerChoice::RayQuery, ReflectionTracerChoice::Bvh] {
        let Some(mut app) = app(SIZE, Output::Picture, tracer) else {
            continue;
        };
        let app = &mut app;
        let camera = spawn_mirror(app, 0.0, SceneName::Demo);
        let mut before = 0;
        for (step, most) in ["start", "glass", "fog"].into_iter().zip(MOST_PIPELINES) {
            match step {
                "start" => {
                    app.world().entity_mut(camera).insert(RayTracedReflections::default());
                }
                "glass" => {
                    let glass = StandardMaterial {
                        specular_transmission: 0.5,
                        ..default()
                    };
                    spawn_mesh(app, Sphere::new(0.5), glass, Transform::from_xyz(-1.0, 0.0, 6.0));
                }
                _ => {
                    app.world()
                        .spawn((FogVolume::default(), Transform::from_scale(Vec3::splat(20.0))));
                    app.world().entity_mut(camera).insert(VolumetricFog::default());
                }
            }
            let start = Instant::now();
            app.step(2);
            while_compiling(app, |_| ());
            let now = pipelines(app).len();
            let (new, time) = (now - before, start.elapsed().as_millis());
            println!("{tracer:?}, {step}: {new} pipelines in {time} ms");
            assert!(
                new > 0 && new <= most,
                "{tracer:?}, {step}: {new} pipelines, at most {most}"
            );
            before = now;
        }
        clear(app);
    }
}

/// Means of the left and the right half of an image.
fn halves(app: &HeadlessApp) -> [f32; 2] {
    let picture = app.capture().unwrap();
    let width = SIZE.x as usize;
    let mut sums = [0.0; 2];
    for (index, pixel) in picture.chunks_exact(4).enumerate() {
        let half = usize::from(index % width >= width / 2);
        sums[half] += pixel[..3].iter().map(|channel| f32::from(*channel)).sum::<f32>();
    }
    sums.map(|sum| sum / (1.5 * (SIZE.x * SIZE.y) as f32))
}

/// Runs frames until nothing compiles any more. Returns the number of frames in which something compiled, and the number of those in
/// which `ready` was true. `look` sees all frames.
fn while_compiling(app: &mut HeadlessApp, mut look: impl FnMut(&mut HeadlessApp)) -> [u32; 2] {
    let mut frames = [0; 2];
    let mut quiet = 0;
    for _ in 0..PATIENCE {
        app.step(1);
        look(app);
        let cache = app.render_world().unwrap().resource::<PipelineCache>();
        let is_compiled = |state: &CachedPipelineState| matches!(state, CachedPipelineState::Ok(_));
        let traces = |label: Option<&str>| {
            label.is_some_and(|label| label.starts_with("glint_trace") || label.starts_with("glint_shade"))
        };
        let waits = cache.waiting_pipelines().count() > 0;
        let lacks = cache.pipelines().any(|pipeline| match &pipeline.descriptor {
            PipelineDescriptor::ComputePipelineDescriptor(compute) => {
                traces(compute.label.as_deref()) && !is_compiled(&pipeline.state)
            }
            _ => false,
        });
        quiet = if waits { 0 } else { quiet + 1 };
        if quiet == 12 {
            return frames;
        }
        frames[0] += u32::from(lacks);
        frames[1] += u32::from(lacks && report(app).ready);
        std::thread::sleep(Duration::from_millis(5));
    }
    panic!("pipelines are still being compiled: {}", report(app));
}

/// A mirror and rough metal, both before a wall that only its lightmap lights, and their camera.
fn spawn_metal_before_a_lightmap(app: &mut HeadlessApp) {
    for (x, roughness) in [(-3.0, 0.0), (3.0, 0.3)] {
        let at = Transform::from_xyz(x, 0.0, 0.0);
        spawn_mesh(app, Rectangle::new(6.0, 12.0), metal(roughness), at);
    }
    let mesh = Mesh::from(Rectangle::new(16.0, 12.0));
    let uv = mesh.attribute(Mesh::ATTRIBUTE_UV_0).unwrap().clone();
    let baked = StandardMaterial {
        perceptual_roughness: 1.0,
        reflectance: 0.0,
        lightmap_exposure: 900.0,
        ..default()
    };
    let at = behind(8.0);
    let wall = spawn_mesh(app, mesh.with_inserted_attribute(Mesh::ATTRIBUTE_UV_1, uv), baked, at);
    let image = add(app, texel([200; 3]));
    let mut images = app.world().resource_mut::<Assets<Image>>();
    let environment = Sky::White.environment(&mut images, 300.0);
    app.world().entity_mut(wall).insert(Lightmap { image, ..default() });
    // The lightmap is there in the first frame with reflections: no shader without it was ever compiled.
    app.spawn_camera((
        BEFORE_THE_MIRROR,
        Tonemapping::None,
        environment,
        RayTracedReflections::default(),
    ));
}

/// An app that compiles pipelines in the background.
fn shipped_app() -> Option<HeadlessApp> {
    let settings = HeadlessSettings {
        size: SIZE,
        synchronous_pipelines: false,
        ..default()
    };
    let plugin = RayTracedReflectionsPlugin {
        tracer: ReflectionTracerChoice::Bvh,
        ..default()
    };
    let mut app = HeadlessApp::new(settings, |app| _ = app.add_plugins(plugin)).unwrap();
    app.step(2);
    if report(&mut app).tracer.is_none() {
        println!("skipped: {}", report(&mut app));
        return None;
    }
    Some(app)
}

#[test]
fn a_new_feature_takes_no_other_one_away_while_its_shader_is_compiled() {
    let Some(mut app) = shipped_app() else { return };
    spawn_metal_before_a_lightmap(&mut app);
    warm_up(&mut app);
    app.step(30);
    let before = halves(&app);
    assert!(before.iter().all(|mean| *mean > 80.0), "{before:?}");
    let aside = Transform::from_xyz(5.0, 5.0, 7.0);
    let features: [(&str, fn(&mut HeadlessApp, Transform) -> Entity); 2] = [
        ("a clearcoat", |app, at| {
            spawn_mesh(app, Sphere::new(0.1), clearcoated(), at)
        }),
        ("a rectangular light", |app, at| {
            let light = RectLight {
                intensity: 10.0,
                range: 3.0,
                width: 0.2,
                height: 0.2,
                ..default()
            };
            app.world().spawn((light, at)).id()
        }),
    ];
    let mut worst = [1.0_f32; 2];
    let mut last = None;
    for (name, add) in features {
        let added = add(&mut app, aside);
        // One is added, and in the second case one is removed.
        if let Some(last) = last.replace(added) {
            app.world().despawn(last);
        }
        let [frames, ready] = while_compiling(&mut app, |app| {
            let now = halves(app);
            for (side, worst) in worst.iter_mut().enumerate() {
                *worst = worst.min(now[side] / before[side]);
            }
        });
        println!("{name}: {frames} frames of compiling, {ready} of them ready; least light {worst:?}");
        assert!(frames > 0, "{name} is compiled in the background");
        // A shader for masks, which could also be used, is compiled first. On a busy machine, the status comes too late.
        assert!(
            frames < 4 || ready < frames,
            "{name}: `ready` is true in {ready} of {frames} frames"
        );
        assert!(worst.iter().all(|part| *part > 0.9), "{name}: {worst:?} of {before:?}");
    }
    assert!(report(&mut app).ready);
}

/// Columns of the image: a deferred wall, a cube that is drawn forward, and a blended pane.
const COLUMNS: [usize; 3] = [48, 20, 68];

/// Spawns an object for each column. None of them reflects.
fn spawn_columns(app: &mut HeadlessApp) {
    let at = Transform::from_xyz;
    spawn_mesh(app, wall(), unlit(BLUE), at(0.0, 0.0, -1.0));
    spawn_mesh(app, Cuboid::from_length(1.0), forward(unlit(GREEN)), at(-0.9, 0.0, 0.0));
    let pane = StandardMaterial {
        base_color: Color::linear_rgba(1.0, 0.0, 0.0, 0.5),
        alpha_mode: AlphaMode::Blend,
        ..unlit(RED)
    };
    spawn_mesh(app, Rectangle::new(1.0, 1.0), pane, at(0.9, 0.0, 0.0));
}

/// Colours of the columns in half height.
fn columns(app: &HeadlessApp) -> [[u8; 3]; 3] {
    let image = app.capture().unwrap();
    let row = (SIZE.x * SIZE.y / 2) as usize;
    COLUMNS.map(|column| image[4 * (row + column)..][..3].try_into().unwrap())
}

/// Inserted, removed, and inserted again: with asynchronous compilation, each frame shows everything.
#[test]
fn reflections_that_begin_in_a_running_game_take_nothing_away() {
    let Some(mut app) = shipped_app() else { return };
    let app = &mut app;
    for is_hdr in [false, true] {
        spawn_columns(app);
        // Without HDR, materials map tones themselves, before panes are blended.
        let (tones, compared) = if is_hdr {
            (Tonemapping::None, 9)
        } else {
            (Tonemapping::AcesFitted, 6)
        };
        let camera = app.spawn_camera((BEFORE_THE_MIRROR, tones));
        if !is_hdr {
            app.world().entity_mut(camera).remove::<Hdr>();
        }
        while_compiling(app, |_| ());
        let before = columns(app);
        println!("HDR: {is_hdr}: {before:?}");
        assert!(
            before[0][2] > 150 && before[1][1] > 150 && before[2][0] > 60,
            "{before:?}"
        );
        for reflects in [true, false, true] {
            let mut camera = app.world().entity_mut(camera);
            if reflects {
                camera.insert(RayTracedReflections::default());
            } else {
                camera.remove::<RayTracedReflections>();
            }
            let (mut frames, mut without) = (0, 0);
            while_compiling(app, |app| {
                let now = columns(app);
                let apart = now.as_flattened().iter().zip(before.as_flattened()).take(compared);
                let apart = apart.map(|(now, before)| now.abs_diff(*before)).max().unwrap();
                frames += 1;
                without += u32::from(apart > 3);
            });
            println!("HDR: {is_hdr}, reflects: {reflects}: {without} of {frames} frames lack something");
            assert_eq!(without, 0, "HDR: {is_hdr}, reflects: {reflects}: of {frames} frames");
            assert_eq!(report(app).ready, reflects, "HDR: {is_hdr}");
        }
        clear(app);
    }
}
