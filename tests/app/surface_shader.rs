//! A shader of the app that changes the surfaces of hits.

use crate::{
    common::app_with,
    pictures::{any_tracer, reflect, warm_up},
    stage::{BEFORE_THE_MIRROR, BLUE, SIZE, metal, set_shader, spawn_camera, spawn_mesh, spawn_of, unlit, wall},
};
use bevy::{
    asset::uuid_handle,
    pbr::{ExtendedMaterial, MaterialExtension},
    prelude::*,
    render::render_resource::AsBindGroup,
    shader::Shader,
};
use bevy_glint::{
    RayTracedReflections, ReflectedMaterialPlugin, ReflectedSurfaceShader, ReflectionTechnique, ReflectionTracerChoice,
};
use glint_scenes::{HeadlessApp, Output, SceneName};

#[derive(Asset, AsBindGroup, Reflect, Clone, Default)]
struct Striped {}
impl MaterialExtension for Striped {}

type OfStripes = ExtendedMaterial<StandardMaterial, Striped>;

const SHADER: Handle<Shader> = uuid_handle!("3b8f4f1e-0d5c-4d0c-9c39-4a1c5b6a7e01");
/// The right half of a mesh pulses. On the left half, everything except the colour is NaN.
const SOURCE: &str = "
    import bevy_glint::scene::surface::Surface;
    import bevy_glint::trace::surface_point::SurfacePoint;

    fn reflected_surface(surface: Surface, at: SurfacePoint) -> Surface {
        var changed = surface;
        if at.material_type == 1u {
            let infinite = exp2(128.0 + at.uv.x);
            let pulse = 0.5 + 0.4 * sin(4.0 * at.seconds);
            changed.base_color = select(vec3(1.0, 0.0, 0.0), vec3(0.0, pulse, 0.0), at.uv.x > 0.5);
            changed.normal *= select(infinite, 1.0, at.uv.x > 0.5);
            changed.perceptual_roughness = select(infinite - infinite, 0.5, at.uv.x > 0.5);
            changed.position += at.to_viewer * infinite;
        }
        return changed;
    }
";

/// Two boards behind the camera: one in the middle of the image with another type than `StandardMaterial`, and a blue one to its right.
fn stage(tracer: ReflectionTracerChoice) -> Option<(HeadlessApp, Entity)> {
    let mut app = app_with(SIZE, Output::Linear, tracer, |app| {
        app.add_plugins((
            ReflectedMaterialPlugin::<OfStripes>::default(),
            MaterialPlugin::<OfStripes>::default(),
        ));
    })?;
    spawn_mesh(&mut app, wall(), metal(0.0), Transform::IDENTITY);
    let place = |x: f32| Transform::from_xyz(x, 0.0, 8.0).looking_to(Vec3::Z, Vec3::Y);
    let board = Rectangle::new(4.0, 4.0);
    spawn_mesh(&mut app, board, unlit(BLUE), place(4.5));
    let striped = OfStripes {
        base: unlit(BLUE),
        extension: Striped {},
    };
    spawn_of(&mut app, board, striped, place(0.0));
    let camera = spawn_camera(&mut app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
    set_source(&mut app, SOURCE.into());
    Some((app, camera))
}

fn set_source(app: &mut HeadlessApp, source: String) {
    set_shader(app, &SHADER, source, "tests/stripes.wesl");
}

fn insert_shader(app: &mut HeadlessApp, animated: bool) {
    app.world().insert_resource(ReflectedSurfaceShader {
        shader: SHADER,
        animated,
    });
}

/// Colours of the left and the right half of the board, and of the blue one, once everything is compiled.
fn shown(app: &mut HeadlessApp) -> [Vec3; 3] {
    app.step(2);
    warm_up(app);
    app.step(4);
    let pixels = app.capture_linear().unwrap();
    for pixel in &pixels {
        assert!(pixel.iter().all(|value| value.is_finite()), "{pixel:?}");
    }
    [41, 55, 79].map(|column| {
        let [r, g, b, _] = pixels[(SIZE.y / 2 * SIZE.x + column) as usize];
        Vec3::new(r, g, b)
    })
}

const PLAIN: Vec3 = Vec3::Z;

/// The mirror shows the front of the mesh reversed: its left half, with small u, is on the right.
#[track_caller]
fn expect(app: &mut HeadlessApp, what: &str, striped: bool) {
    let [left, right, blue] = shown(app);
    let pulse = 0.5 + 0.4 * (4.0 * app.world().resource::<Time>().elapsed_secs_wrapped()).sin();
    let expected = if striped {
        [Vec3::Y * pulse, Vec3::X]
    } else {
        [PLAIN; 2]
    };
    println!("{what}: {left}, {right}, {blue}; expected {expected:?}");
    for (color, expected) in [left, right, blue].into_iter().zip(expected.into_iter().chain([PLAIN])) {
        assert!(color.distance(expected) < 0.02, "{what}: {color}, expected {expected}");
    }
}

#[test]
fn reflections_show_the_surfaces_of_the_apps_shader() {
    for tracer in any_tracer() {
        let Some((mut app, camera)) = stage(tracer) else {
            continue;
        };
        let app = &mut app;
        // The passes that shade hits. Each takes seconds to compile.
        let techniques: &[_] = match tracer {
            ReflectionTracerChoice::RayQuery => &[(ReflectionTechnique::Converged, false)],
            _ => &[
                (ReflectionTechnique::Reference, false),
                (ReflectionTechnique::Quarter, true),
                (ReflectionTechnique::QuarterInline, false),
            ],
        };
        for &(technique, own_rays) in techniques {
            reflect(app, camera, technique);
            let settings = app.world().get_mut::<RayTracedReflections>(camera);
            settings.unwrap().full_resolution_mirrors = own_rays;
            let name = |what: &str| format!("{tracer:?}, {technique:?}, {what}");
            expect(app, &name("without"), false);
            app.world().resource_mut::<Time<Virtual>>().pause();
            insert_shader(app, true);
            expect(app, &name("with"), true);
            app.world().resource_mut::<Time<Virtual>>().unpause();
            app.step(5);
            app.world().resource_mut::<Time<Virtual>>().pause();
            app.world().get_mut::<RayTracedReflections>(camera).unwrap().reset = true;
            expect(app, &name("later"), true);
            app.world().remove_resource::<ReflectedSurfaceShader>();
            expect(app, &name("without it again"), false);
            app.world().resource_mut::<Time<Virtual>>().unpause();
        }
    }
}

/// Edits of a shader take effect, even in a static image, and a shader with errors is ignored.
#[test]
fn an_edited_surface_shader_is_followed() {
    let Some((mut app, camera)) = stage(ReflectionTracerChoice::Bvh) else {
        return;
    };
    let app = &mut app;
    let still = SOURCE.replace("4.0 * at.seconds", "0.0");
    set_source(app, still.clone());
    reflect(app, camera, ReflectionTechnique::Converged);
    insert_shader(app, false);
    let expect = |app: &mut HeadlessApp, what: &str, source: Option<String>, expected: [Vec3; 2]| {
        source.into_iter().for_each(|source| set_source(app, source));
        // Failures are reported late.
        for _ in 0..20 {
            app.step(1);
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        let [left, right, blue] = shown(app);
        println!("{what}: {left}, {right}, {blue}");
        for (color, expected) in [left, right, blue].into_iter().zip(expected.into_iter().chain([PLAIN])) {
            assert!(color.distance(expected) < 0.02, "{what}: {color}, expected {expected}");
        }
    };
    let as_it_was = [0.5 * Vec3::Y, Vec3::X];
    expect(app, "at first", None, as_it_was);
    let orange = still.replace("vec3(1.0, 0.0, 0.0)", "vec3(1.0, 0.5, 0.0)");
    expect(app, "edited", Some(orange), [0.5 * Vec3::Y, Vec3::new(1.0, 0.5, 0.0)]);
    let faulty = still.replace("return changed", "return no_such_thing");
    expect(app, "a faulty one", Some(faulty), [PLAIN; 2]);
    expect(app, "mended", Some(still), as_it_was);
    app.world().remove_resource::<ReflectedSurfaceShader>();
    expect(app, "removed", None, [PLAIN; 2]);
}
