//! Compares the back ends: the rays are the same for each pass that starts them.

use crate::{
    common::app_on_device,
    pictures::{BOTH, COARSE, any_tracer, assert_flip, use_coarse_shadow_maps, warm_up},
    stage::report,
};
use bevy::{
    camera::RenderTarget,
    math::UVec2,
    prelude::*,
    render::{
        RenderApp,
        render_resource::{TextureFormat, TextureUsages},
        renderer::RenderAdapterInfo,
    },
};
#[cfg(feature = "hardware-vrs")]
use bevy_glint::{CombinedThresholds, HardwareVrs, HardwareVrsPlugin, internals::refuse_memory};
use bevy_glint::{
    HardwareVrsSupport, RayTracedReflections, ReflectionBackend, ReflectionStatusReport, ReflectionTechnique,
    ReflectionTracerChoice, ShadingRate, ShadingRateHeuristic,
    internals::{Copied, CountInvocations, RATE_ACTIVE, Target, readback},
};
#[cfg(feature = "hardware-vrs")]
use glint_scenes::is_alone;
use glint_scenes::{HeadlessApp, Output, SceneName, camera, environment, read_image};

const SCENE: SceneName = SceneName::Demo;
/// Neither even nor a multiple of the tiles.
const SIZE: UVec2 = UVec2::new(137, 83);
/// Trace pixels of a tile.
const TILE: u32 = 16;

/// Bit of a record's second word.
const RECORD_VALID: u32 = 0x40 << 16;
/// The third word is a motion: only rays of lists have one.
const RECORD_MOTION: u32 = 0x100 << 16;
/// Tolerance of a direction or a pdf in steps of 16 bits, for two compilers that translated the same shader.
const RECORD_STEPS: u32 = 2;
/// Steps of a half float of the radiance.
const RADIANCE_STEPS: u32 = 4;

/// A camera of the test with its image.
struct Viewer {
    camera: Entity,
    picture: Handle<Image>,
}

/// An app that counts invocations. Its own small camera keeps the scene on the GPU while the cameras of the test come and go.
fn app(tracer: ReflectionTracerChoice, before: impl FnOnce(&mut App)) -> Option<HeadlessApp> {
    let mut app = app_on_device(UVec2::splat(16), Output::Picture, tracer, before, |app| {
        if let Some(render) = app.get_sub_app_mut(RenderApp) {
            render.insert_resource(CountInvocations);
        }
    })?;
    use_coarse_shadow_maps(&mut app);
    let keeper = app.spawn_scene(SCENE, &COARSE);
    app.world().entity_mut(keeper).insert(RayTracedReflections {
        technique: ReflectionTechnique::Quarter,
        ..default()
    });
    Some(app)
}

fn add(
    app: &mut HeadlessApp,
    technique: ReflectionTechnique,
    backend: ReflectionBackend,
    heuristic: &ShadingRateHeuristic,
) -> Viewer {
    let reflections = RayTracedReflections {
        technique,
        backend,
        ..default()
    };
    add_with(app, reflections, heuristic)
}

fn add_variable(app: &mut HeadlessApp, backend: ReflectionBackend, heuristic: &ShadingRateHeuristic) -> Viewer {
    add(app, ReflectionTechnique::Variable, backend, heuristic)
}

fn add_with(app: &mut HeadlessApp, reflections: RayTracedReflections, heuristic: &ShadingRateHeuristic) -> Viewer {
    let mut image = Image::new_target_texture(SIZE.x, SIZE.y, TextureFormat::Rgba8UnormSrgb, None);
    image.texture_descriptor.usage |= TextureUsages::COPY_SRC;
    let picture = app.world().resource_mut::<Assets<Image>>().add(image);
    let (transform, projection) = camera(SCENE);
    let camera = app.spawn_camera((
        transform,
        Projection::from(projection),
        RenderTarget::from(picture.clone()),
        reflections,
        heuristic.clone(),
    ));
    let environment = environment(SCENE, app.world());
    environment.insert(&mut app.world().entity_mut(camera));
    Viewer { camera, picture }
}

fn remove(app: &mut HeadlessApp, viewers: impl IntoIterator<Item = Viewer>) {
    for viewer in viewers {
        app.world().despawn(viewer.camera);
    }
}

/// Restarts the cameras in the same frame, so that they draw the same samples of the same scene, and renders some frames.
fn render_together(app: &mut HeadlessApp, viewers: &[Viewer]) {
    warm_up(app);
    for is_active in [false, true] {
        for viewer in viewers {
            app.world().get_mut::<Camera>(viewer.camera).unwrap().is_active = is_active;
        }
        app.step(4);
    }
    app.step(1);
}

fn active_backend(app: &mut HeadlessApp, viewer: &Viewer) -> Option<ReflectionBackend> {
    let backends = report(app).active_backends;
    let own = backends.into_iter().find(|(camera, _)| *camera == viewer.camera);
    own.map(|(_, backend)| backend)
}

/// The CPU driver computes the same results with every kind of shader.
fn is_exact(app: &mut HeadlessApp) -> bool {
    let render = app.app().get_sub_app(RenderApp).unwrap().world();
    render.resource::<RenderAdapterInfo>().device_type == wgpu::DeviceType::Cpu
}

/// In fragment shaders, Mesa's CPU driver (25.0) reads candidates of ray queries for lanes without one, and crashes.
fn has_fragment_rays(app: &mut HeadlessApp, tracer: ReflectionTracerChoice) -> bool {
    let crashes = tracer == ReflectionTracerChoice::RayQuery && is_exact(app);
    if crashes {
        println!("skipped: ray queries in fragment shaders, which crash the CPU driver");
    }
    !crashes
}

fn copied(app: &mut HeadlessApp, viewer: &Viewer, target: Target) -> Copied {
    let copied = readback::copy(app.app(), viewer.camera, target);
    copied.unwrap_or_else(|| panic!("{target:?} can't be read"))
}

fn picture(app: &mut HeadlessApp, viewer: &Viewer) -> Vec<u8> {
    let render = app.app().get_sub_app(RenderApp).unwrap().world();
    let mut bytes = read_image(render, &viewer.picture).unwrap();
    bytes.chunks_exact_mut(4).for_each(|pixel| pixel[3] = 255);
    bytes
}

/// Invocations that traced a ray, by the logarithm of their block's number of trace pixels.
fn counted(app: &mut HeadlessApp, viewer: &Viewer) -> Vec<u32> {
    copied(app, viewer, Target::Counters).words[2..7].to_vec()
}

/// Like `counted`, for the list of blocks.
fn listed(app: &mut HeadlessApp, viewer: &Viewer) -> Vec<u32> {
    let count = copied(app, viewer, Target::IndirectArgs).words[12] as usize;
    let mut sizes = vec![0; 5];
    for block in &copied(app, viewer, Target::RayList).words[..count] {
        sizes[((block >> 26 & 3) + (block >> 28 & 3)) as usize] += 1;
    }
    sizes
}

/// How the rays of two cameras differ.
#[derive(Debug, Default)]
struct Differences {
    /// Trace pixels with a ray.
    rays: u32,
    /// One of them has a ray, and the other doesn't.
    validity: u32,
    /// The ray starts at another pixel of the block, or at another surface.
    origins: u32,
    /// Words that differ.
    record_words: u32,
    radiance_words: u32,
    /// Trace pixels with more than a difference in the last bits.
    far_records: u32,
    far_radiance: u32,
}

/// Differences of two words' halves, in steps.
fn steps(a: u32, b: u32, order: fn(u16) -> i32) -> u32 {
    let half = |shift: u32| order((a >> shift) as u16).abs_diff(order((b >> shift) as u16));
    half(0).max(half(16))
}

fn snorm(bits: u16) -> i32 {
    i32::from(bits as i16)
}

fn half_float(bits: u16) -> i32 {
    let magnitude = i32::from(bits & 0x7fff);
    if bits & 0x8000 == 0 { magnitude } else { -magnitude }
}

fn differences(app: &mut HeadlessApp, a: &Viewer, b: &Viewer) -> Differences {
    let rates = copied(app, a, Target::Rate);
    assert_eq!(rates, copied(app, b, Target::Rate), "both cameras have the same rates");
    let [records, radiance] = [Target::RaySample, Target::RayRadiance].map(|target| {
        let both = [copied(app, a, target), copied(app, b, target)];
        assert_eq!(both[0].size, both[1].size);
        both
    });
    let size = records[0].size;
    let mut found = Differences::default();
    let count = |a: &[u32], b: &[u32]| a.iter().zip(b).filter(|(a, b)| a != b).count() as u32;
    for place in (0..size.y).flat_map(|y| (0..size.x).map(move |x| UVec2::new(x, y))) {
        if rates.at(place / TILE)[0] & RATE_ACTIVE == 0 {
            continue;
        }
        let both = [0, 1].map(|index| records[index].at(place));
        let moves = both.iter().any(|record| record[1] & RECORD_MOTION != 0);
        let [a, b] = both.map(|record| {
            let depth = if moves { 0 } else { record[2] };
            [record[0], record[1] & !RECORD_MOTION, depth, record[3]]
        });
        let (a, b) = (&a[..], &b[..]);
        let valid = |record: &[u32]| record[1] & RECORD_VALID != 0;
        if !valid(a) && !valid(b) {
            continue;
        }
        found.rays += 1;
        if valid(a) != valid(b) {
            found.validity += 1;
            continue;
        }
        found.record_words += count(a, b);
        found.origins += u32::from(a[1] >> 16 != b[1] >> 16 || a[2..] != b[2..]);
        let pdf = (a[1] & 0xffff).abs_diff(b[1] & 0xffff);
        found.far_records += u32::from(steps(a[0], b[0], snorm).max(pdf) > RECORD_STEPS);
        let (a, b) = (radiance[0].at(place), radiance[1].at(place));
        found.radiance_words += count(a, b);
        let far = a.iter().zip(b).map(|(a, b)| steps(*a, *b, half_float)).max();
        found.far_radiance += u32::from(far.is_some_and(|far| far > RADIANCE_STEPS));
    }
    found
}

#[track_caller]
fn assert_same_rays(app: &mut HeadlessApp, name: &str, a: &Viewer, b: &Viewer) {
    let found = differences(app, a, b);
    println!("{name}: {found:?}");
    assert!(found.rays > 1000, "{name}: the scene reflects");
    assert_eq!((found.validity, found.origins), (0, 0), "{name}");
    if is_exact(app) {
        assert_eq!((found.record_words, found.radiance_words), (0, 0), "{name}");
    }
    // A last bit of the direction can lead past an edge.
    assert!(found.far_records * 200 <= found.rays, "{name}");
    assert!(found.far_radiance * 100 <= found.rays, "{name}");
}

/// Techniques and back ends that share an app, because starting one takes most of the time.
#[test]
fn compute_passes_trace_the_same_rays() {
    for tracer in any_tracer() {
        let Some(mut app) = app(tracer, |_| {}) else { continue };
        for max_bounces in [1, 3] {
            assert_techniques_agree(&mut app, tracer, max_bounces);
        }
        if tracer == ReflectionTracerChoice::RayQuery {
            compute_takes_the_place_of_fragments_that_would_crash(&mut app);
        } else {
            compute_takes_the_place_of_missing_hardware(&mut app);
        }
    }
}

/// At one ray per trace pixel, the techniques with 1/4 ray per pixel are identical, and so are the passes that follow rays beyond their
/// first hit.
fn assert_techniques_agree(app: &mut HeadlessApp, tracer: ReflectionTracerChoice, max_bounces: u32) {
    let one = ShadingRateHeuristic::Uniform(ShadingRate::R1x1);
    let mut techniques = vec![ReflectionTechnique::Variable, ReflectionTechnique::Quarter];
    if has_fragment_rays(app, tracer) {
        techniques.push(ReflectionTechnique::QuarterInline);
    }
    let viewers: Vec<_> = techniques
        .iter()
        .map(|technique| {
            let reflections = RayTracedReflections {
                technique: *technique,
                max_bounces,
                bounce_roughness_cutoff: 1.0,
                ..default()
            };
            add_with(app, reflections, &one)
        })
        .collect();
    render_together(app, &viewers);
    let (first, others) = viewers.split_first().unwrap();
    let (rays, blocks) = (counted(app, first), listed(app, first));
    println!("{tracer:?}: {rays:?} rays of {blocks:?} blocks");
    assert!(blocks[0] > 1000, "{blocks:?}");
    assert_eq!(rays, blocks);
    assert_eq!(&blocks[1..], &[0; 4]);
    let expected = picture(app, first);
    for (other, technique) in others.iter().zip(&techniques[1..]) {
        let name = format!("{technique:?}-{tracer:?}-{max_bounces}-bounces");
        assert_same_rays(app, &name, first, other);
        assert_eq!(counted(app, other), rays, "{name}");
        let actual = picture(app, other);
        // Histories of inline rays don't follow moving objects.
        let limit = match technique {
            _ if !is_exact(app) => 0.01,
            ReflectionTechnique::QuarterInline => 0.0005,
            _ => 0.0,
        };
        assert_flip(&name, SIZE, &expected, &actual, limit);
    }
    remove(app, viewers);
}

/// If the hardware back end can't be used, compute takes its place and the status gives the reason.
fn compute_takes_the_place_of_missing_hardware(app: &mut HeadlessApp) {
    let heuristic = ShadingRateHeuristic::default();
    let viewer = add_variable(app, ReflectionBackend::HardwareVrs, &heuristic);
    warm_up(app);
    assert_eq!(active_backend(app, &viewer), Some(ReflectionBackend::Compute));
    let is_said =
        |report: ReflectionStatusReport| report.reasons.iter().any(|reason| reason.contains("hardware back end"));
    assert!(is_said(report(app)), "{}", report(app));
    assert_eq!(report(app).hardware_vrs, HardwareVrsSupport::NotAsked);

    let mut reflections = app.world().get_mut::<RayTracedReflections>(viewer.camera).unwrap();
    reflections.backend = ReflectionBackend::Auto;
    app.step(2);
    assert!(!is_said(report(app)), "{}", report(app));
    assert_eq!(active_backend(app, &viewer), Some(ReflectionBackend::Compute));
    app.world().despawn(viewer.camera);
    app.step(2);
    assert_eq!(active_backend(app, &viewer), None);
}

/// If ray queries in fragment shaders would crash the driver, a compute shader traces the rays and the status reports it.
fn compute_takes_the_place_of_fragments_that_would_crash(app: &mut HeadlessApp) {
    if !is_exact(app) {
        println!("skipped: ray queries of another driver");
        return;
    }
    let one = ShadingRateHeuristic::Uniform(ShadingRate::R1x1);
    let viewers = [ReflectionTechnique::Quarter, ReflectionTechnique::QuarterInline]
        .map(|technique| add(app, technique, ReflectionBackend::Compute, &one));
    render_together(app, &viewers);
    let reasons = report(app).reasons;
    assert!(
        reasons.iter().any(|reason| reason.contains("fragment shaders")),
        "{reasons:?}"
    );
    assert_same_rays(app, "fallback", &viewers[0], &viewers[1]);
    remove(app, viewers);
}

#[cfg(feature = "hardware-vrs")]
fn add_of_both_back_ends(app: &mut HeadlessApp, heuristic: &ShadingRateHeuristic) -> [Viewer; 2] {
    [ReflectionBackend::Compute, ReflectionBackend::HardwareVrs].map(|backend| add_variable(app, backend, heuristic))
}

/// An app with the raw Vulkan pass, even without shading rates; `None` (with the reason printed) if this machine can't have one.
#[cfg(feature = "hardware-vrs")]
fn app_with_raw_pass(tracer: ReflectionTracerChoice) -> Option<HeadlessApp> {
    let mut app = app(tracer, |app| {
        app.add_plugins(HardwareVrsPlugin { allow_full_rate: true });
    })?;
    if let HardwareVrsSupport::Missing(reason) = report(&mut app).hardware_vrs {
        println!("skipped: {reason}");
        return None;
    }
    Some(app)
}

/// The raw Vulkan pass without its shading-rate attachment, so that other devices test it, too.
#[cfg(feature = "hardware-vrs")]
#[test]
fn the_raw_pass_traces_the_rays_of_the_others() {
    for tracer in [ReflectionTracerChoice::Bvh, ReflectionTracerChoice::RayQuery] {
        let Some(mut app) = app_with_raw_pass(tracer) else {
            continue;
        };
        let one = ShadingRateHeuristic::Uniform(ShadingRate::R1x1);
        let viewers = [
            (ReflectionTechnique::QuarterInline, ReflectionBackend::Auto),
            (ReflectionTechnique::Variable, ReflectionBackend::HardwareVrs),
        ]
        .map(|(technique, backend)| add(&mut app, technique, backend, &one));
        render_together(&mut app, &viewers);
        assert_eq!(active_backend(&mut app, &viewers[0]), Some(ReflectionBackend::Compute));
        assert_eq!(
            active_backend(&mut app, &viewers[1]),
            Some(ReflectionBackend::HardwareVrs)
        );
        assert_same_rays(&mut app, &format!("raw-{tracer:?}"), &viewers[0], &viewers[1]);
        assert_eq!(counted(&mut app, &viewers[0]), counted(&mut app, &viewers[1]));
        let limit = if is_exact(&mut app) { 0.0 } else { 0.01 };
        let (expected, actual) = (picture(&mut app, &viewers[0]), picture(&mut app, &viewers[1]));
        assert_flip(&format!("raw-{tracer:?}"), SIZE, &expected, &actual, limit);

        // Coarse blocks: if the rasterizer doesn't support them, all their pixels trace the block's ray.
        let coarse = ShadingRateHeuristic::PAPER_GRAZING;
        let viewers = add_of_both_back_ends(&mut app, &coarse);
        render_together(&mut app, &viewers);
        assert_same_rays(&mut app, &format!("raw-coarse-{tracer:?}"), &viewers[0], &viewers[1]);
        let [compute, hardware] = viewers.each_ref().map(|viewer| counted(&mut app, viewer));
        println!("{tracer:?}: {compute:?} and {hardware:?} invocations");
        assert!(
            compute
                .iter()
                .zip(&hardware)
                .all(|(compute, hardware)| compute <= hardware)
        );
        if !has_fragment_rays(&mut app, ReflectionTracerChoice::RayQuery) {
            return;
        }
    }
}

/// After an error, compute shaders trace until the pass is tried again.
#[cfg(feature = "hardware-vrs")]
#[test]
#[ignore = "long: 629 frames"]
fn the_raw_pass_is_taken_up_again_after_an_error() {
    if !is_alone("back_ends::the_raw_pass_is_taken_up_again_after_an_error") {
        return;
    }
    let Some(mut app) = app_with_raw_pass(ReflectionTracerChoice::Bvh) else {
        return;
    };
    let one = ShadingRateHeuristic::Uniform(ShadingRate::R1x1);
    let viewer = add_variable(&mut app, ReflectionBackend::HardwareVrs, &one);
    render_together(&mut app, std::slice::from_ref(&viewer));
    let device = app.device().unwrap().clone();
    let active = |app: &mut HeadlessApp| active_backend(app, &viewer);
    assert_eq!(active(&mut app), Some(ReflectionBackend::HardwareVrs));
    refuse_memory(&device, true);
    app.step(3);
    refuse_memory(&device, false);
    assert_eq!(active(&mut app), Some(ReflectionBackend::Compute));
    // Not drawn meanwhile, because drawing the image takes time.
    app.world().get_mut::<Camera>(viewer.camera).unwrap().is_active = false;
    app.step(580);
    app.world().get_mut::<Camera>(viewer.camera).unwrap().is_active = true;
    app.step(3);
    assert_eq!(active(&mut app), Some(ReflectionBackend::Compute), "it is too early");
    let frames = (1..60).find(|_| {
        app.step(1);
        active(&mut app) == Some(ReflectionBackend::HardwareVrs)
    });
    assert!(frames.is_some(), "{:?}", report(&mut app));
}

/// With shading rates, the rasterizer starts one invocation for each block of the list.
#[cfg(feature = "hardware-vrs")]
#[test]
fn hardware_rates_start_the_rays_of_the_list() {
    for tracer in BOTH {
        let before = |app: &mut App| {
            app.add_plugins(HardwareVrsPlugin::default());
        };
        let Some(mut app) = app(tracer, before) else { continue };
        let status = report(&mut app);
        let rates = app.world().resource::<HardwareVrs>().rates();
        let (HardwareVrsSupport::Available, Some(rates)) = (&status.hardware_vrs, rates) else {
            let is_required = std::env::var_os("GLINT_REQUIRE_HARDWARE_RATES").is_some();
            assert!(
                !is_required,
                "hardware rates are required, but: {:?}",
                status.hardware_vrs
            );
            println!("skipped: {:?}", status.hardware_vrs);
            continue;
        };
        println!("{}: {rates:?}", status.adapter);
        let first = ShadingRateHeuristic::PAPER_ROUGHNESS;
        let viewers = add_of_both_back_ends(&mut app, &first);
        let supports = |rate: ShadingRate| rates.supports(rate.code());
        let is_large = [ShadingRate::R4x2, ShadingRate::R2x4, ShadingRate::R4x4]
            .into_iter()
            .all(supports);
        let coarsest = if is_large { ShadingRate::R4x4 } else { ShadingRate::R2x2 };
        let combined = ShadingRateHeuristic::Combined(CombinedThresholds {
            coarsest,
            quarter: 0.3,
            eighth: 0.4,
            ..default()
        });
        // Rates that the device lacks are replaced by finer ones.
        let uniform = ShadingRate::ALL.into_iter().filter(|rate| supports(*rate));
        let heuristics = [first, ShadingRateHeuristic::PAPER_GRAZING, combined];
        for heuristic in heuristics.into_iter().chain(uniform.map(ShadingRateHeuristic::Uniform)) {
            let name = format!("hardware-{tracer:?}-{heuristic:?}");
            for viewer in &viewers {
                app.world().entity_mut(viewer.camera).insert(heuristic.clone());
            }
            render_together(&mut app, &viewers);
            assert_eq!(
                active_backend(&mut app, &viewers[1]),
                Some(ReflectionBackend::HardwareVrs),
                "{name}"
            );
            assert_same_rays(&mut app, &name, &viewers[0], &viewers[1]);
            let [compute, hardware] = viewers.each_ref().map(|viewer| counted(&mut app, viewer));
            let blocks = listed(&mut app, &viewers[0]);
            println!("    {hardware:?} invocations for {blocks:?} blocks");
            assert_eq!(hardware, compute, "{name}");
            assert_eq!(hardware, blocks, "{name}");
        }
    }
}
