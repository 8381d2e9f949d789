//! Normals that an app's own shader computes, in reflections on glass and water and on opaque surfaces that are drawn forward.

use crate::{
    common::app_with,
    pictures::{BOTH, any_tracer, reflect, warm_up},
    stage::{
        BEFORE_THE_MIRROR, GREEN, RED, SIZE, behind, clear_glass, forward, metal, set_shader, sheet, spawn_camera,
        spawn_mesh, spawn_of, unlit,
    },
};
use bevy::{
    asset::uuid_handle,
    pbr::{ExtendedMaterial, MaterialExtension},
    prelude::*,
    render::render_resource::AsBindGroup,
    shader::{Shader, ShaderRef},
};
use bevy_glint::{
    FrontLayerShader, NotReflected, ReflectedMaterialPlugin, ReflectionDebugView, ReflectionTechnique,
    ReflectionTracerChoice,
};
use glint_scenes::{HeadlessApp, Output, SceneName};

#[derive(Asset, AsBindGroup, Reflect, Clone, Default)]
struct Broken {}
impl MaterialExtension for Broken {}

#[derive(Asset, AsBindGroup, Reflect, Clone, Default)]
struct Leaning {}
impl MaterialExtension for Leaning {}

type OfBroken = ExtendedMaterial<StandardMaterial, Broken>;
type OfLeaning = ExtendedMaterial<StandardMaterial, Leaning>;

const SHADER: Handle<Shader> = uuid_handle!("0d1a3c52-65e8-4a57-9c0b-6d3f5e8a7b21");
const FAULTY: Handle<Shader> = uuid_handle!("0d1a3c52-65e8-4a57-9c0b-6d3f5e8a7b22");
const SOURCE: &str = "
    import bevy_glint::front_layer::layer::{find_surface, layer_pixel, seconds, write_surface};

    @compute @workgroup_size(8, 8, 1)
    fn find(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
        let pixel = layer_pixel(group, local);
        var front = find_surface(pixel);
        let angle = 0.6 + 0.15 * sin(4.0 * seconds());
        if front.material_type == 1u {
            front.surface.normal *= exp2(128.0 + front.share);
        } else if front.material_type == 2u {
            front.surface.normal = vec3(sin(angle), 0.0, cos(angle));
        }
        write_surface(pixel, front);
    }
";

/// Three panes side by side over black, of a `StandardMaterial` and of two other types. Behind the camera it is red, to its right green.
fn stage(tracer: ReflectionTracerChoice) -> Option<(HeadlessApp, Entity)> {
    let mut app = app_with(SIZE, Output::Linear, tracer, |app| {
        app.add_plugins((
            ReflectedMaterialPlugin::<OfBroken>::default(),
            ReflectedMaterialPlugin::<StandardMaterial>::default(),
            ReflectedMaterialPlugin::<OfLeaning>::default(),
            MaterialPlugin::<OfBroken>::default(),
            MaterialPlugin::<OfLeaning>::default(),
        ));
    })?;
    let glass = clear_glass();
    let pane = Rectangle::new(0.7, 3.0);
    let place = |column: f32| Transform::from_xyz(0.75 * column, 0.0, 0.8);
    spawn_mesh(&mut app, pane, glass.clone(), place(-1.0));
    let broken = OfBroken {
        base: glass.clone(),
        extension: Broken {},
    };
    let leaning = OfLeaning {
        base: glass,
        extension: Leaning {},
    };
    spawn_of(&mut app, pane, broken, place(0.0));
    spawn_of(&mut app, pane, leaning, place(1.0));
    let at = Transform::from_xyz(0.0, 0.0, -9.0);
    let back = spawn_mesh(&mut app, Rectangle::new(90.0, 90.0), unlit([0; 3]), at);
    app.world().entity_mut(back).insert(NotReflected);
    for (color, at) in [
        (RED, behind(9.0)),
        (GREEN, Transform::from_xyz(8.0, 0.0, 0.0).looking_to(Vec3::X, Vec3::Y)),
    ] {
        spawn_mesh(&mut app, Rectangle::new(120.0, 120.0), unlit(color), at);
    }
    let camera = spawn_camera(&mut app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
    set_shader(&mut app, &SHADER, SOURCE, "tests/leaning.wesl");
    reflect(&mut app, camera, ReflectionTechnique::Reference);
    Some((app, camera))
}

/// Colours of the middles of the panes, once everything is compiled.
fn panes(app: &mut HeadlessApp) -> [Vec3; 3] {
    app.step(2);
    warm_up(app);
    app.step(4);
    let pixels = app.capture_linear().unwrap();
    [SIZE.x / 6, SIZE.x / 2, 5 * SIZE.x / 6].map(|column| {
        let [r, g, b, _] = pixels[(SIZE.y / 2 * SIZE.x + column) as usize];
        Vec3::new(r, g, b)
    })
}

/// An app's shader turns the normals of its own materials, and no others. NaN does no harm.
#[test]
fn reflections_follow_the_normals_of_the_apps_shader() {
    for tracer in any_tracer() {
        let Some((mut app, camera)) = stage(tracer) else {
            continue;
        };
        let app = &mut app;
        let is_red = |color: Vec3| color.x > 0.1 && color.y < 0.01;
        let is_green = |color: Vec3| color.y > 0.1 && color.x < 0.01;
        let flat = panes(app);
        assert!(flat.iter().all(|color| is_red(*color)), "{tracer:?}: {flat:?}");
        app.world().insert_resource(FrontLayerShader(SHADER));
        let [standard, broken, leaning] = panes(app);
        assert!(
            is_red(standard) && is_red(broken) && is_green(leaning),
            "{tracer:?}: {standard}, {broken}, {leaning}"
        );

        // The clock moves them.
        app.world().entity_mut(camera).insert(ReflectionDebugView::FrontLayer);
        for _ in 0..2 {
            app.step(8);
            app.world().resource_mut::<Time<Virtual>>().pause();
            let [standard, broken, leaning] = panes(app);
            let seconds = app.world().resource::<Time>().elapsed_secs_wrapped();
            app.world().resource_mut::<Time<Virtual>>().unpause();
            let angle = 0.6 + 0.15 * (4.0 * seconds).sin();
            println!("{tracer:?}, after {seconds} s: {standard}, {broken}, {leaning}");
            let shown = |normal: Vec3| 0.5 + 0.5 * normal;
            for (color, normal) in [
                (standard, Vec3::Z),
                (broken, Vec3::Z),
                (leaning, Vec3::new(angle.sin(), 0.0, angle.cos())),
            ] {
                let off = color.distance(shown(normal));
                assert!(
                    off < 0.004,
                    "{tracer:?}, after {seconds} s: {color}, expected {}",
                    shown(normal)
                );
            }
        }
        app.world().entity_mut(camera).remove::<ReflectionDebugView>();
        app.world().remove_resource::<FrontLayerShader>();
        let flat = panes(app);
        assert!(flat.iter().all(|color| is_red(*color)), "{tracer:?}: {flat:?}");
    }
}

/// The library's shader replaces one that fails to compile.
#[test]
fn a_faulty_shader_leaves_reflections_as_they_are() {
    let Some((mut app, _)) = stage(BOTH[1]) else { return };
    let app = &mut app;
    let before = panes(app);
    let source = SOURCE.replace("find_surface(pixel)", "no_such_function(pixel)");
    set_shader(app, &FAULTY, source, "tests/faulty.wesl");
    app.world().insert_resource(FrontLayerShader(FAULTY));
    (0..200).for_each(|_| {
        app.step(1);
        std::thread::sleep(std::time::Duration::from_millis(5));
    });
    let pixels = app.capture_linear().unwrap();
    let [left, ..] = pixels[(SIZE.y / 2 * SIZE.x + SIZE.x / 6) as usize];
    assert!((left - before[0].x).abs() < 0.002, "{left}, {before:?}");
}

const OWN: Handle<Shader> = uuid_handle!("7c1f3a52-65e8-4a57-9c0b-6d3f5e8a7b31");
const FORWARD_LAYER: Handle<Shader> = uuid_handle!("7c1f3a52-65e8-4a57-9c0b-6d3f5e8a7b32");

/// An extension with its own shader.
#[derive(Asset, AsBindGroup, Reflect, Clone, Default)]
struct Polished {}

impl MaterialExtension for Polished {
    fn fragment_shader() -> ShaderRef {
        OWN.into()
    }
}

type OfPolished = ExtendedMaterial<StandardMaterial, Polished>;

/// An extended material reflects as its base, and with the normals from the app's shader.
#[test]
fn extended_materials_with_their_own_shaders_reflect() {
    for tracer in any_tracer() {
        let Some(mut app) = app_with(SIZE, Output::Linear, tracer, |app| {
            app.add_plugins((
                ReflectedMaterialPlugin::<OfPolished>::default(),
                MaterialPlugin::<OfPolished>::default(),
            ));
        }) else {
            continue;
        };
        let app = &mut app;
        let own = "
            import bevy_pbr::render::forward_io::{FragmentOutput, VertexOutput};
            import bevy_pbr::render::pbr_fragment::pbr_input_from_standard_material;
            import bevy_pbr::render::pbr_functions::apply_pbr_lighting;
            @fragment
            fn fragment(in: VertexOutput, @builtin(front_facing) is_front: bool) -> FragmentOutput {
                var out: FragmentOutput;
                out.color = apply_pbr_lighting(pbr_input_from_standard_material(in, is_front));
                return out;
            }
        ";
        let layer = "
            import bevy_glint::front_layer::layer::{find_surface, layer_pixel, write_surface};
            @compute @workgroup_size(8, 8, 1)
            fn find(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
                let pixel = layer_pixel(group, local);
                var front = find_surface(pixel);
                if front.material_type == 1u {
                    front.surface.normal = vec3(sin(0.7), 0.0, cos(0.7));
                }
                write_surface(pixel, front);
            }
        ";
        set_shader(app, &OWN, own, "tests/own.wesl");
        set_shader(app, &FORWARD_LAYER, layer, "tests/own_layer.wesl");
        let polished = OfPolished {
            base: forward(metal(0.0)),
            extension: Polished {},
        };
        spawn_of(app, sheet(), polished, Transform::from_xyz(0.0, 0.0, -1.0));
        for (color, at) in [
            (RED, behind(9.0)),
            (GREEN, Transform::from_xyz(30.0, 0.0, 0.0).looking_to(Vec3::X, Vec3::Y)),
        ] {
            spawn_mesh(app, Rectangle::new(60.0, 60.0), unlit(color), at);
        }
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
        reflect(app, camera, ReflectionTechnique::Reference);
        let [_, flat, _] = panes(app);
        assert!(flat.x > 0.9 && flat.y < 0.05, "{tracer:?}: {flat}");
        app.world().insert_resource(FrontLayerShader(FORWARD_LAYER));
        let [_, leaning, _] = panes(app);
        assert!(leaning.y > 0.9 && leaning.x < 0.05, "{tracer:?}: {leaning}");
    }
}
