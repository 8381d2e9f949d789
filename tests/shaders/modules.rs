//! Shader modules link and validate in every combination of definitions, and their structs match the CPU's.

use std::{mem::offset_of, sync::Arc};

use crate::wesl::{Shaders, struct_layout};
use bevy_glint::internals::{atmosphere::GpuAir, environment::GpuEnvironment, fog_volumes::GpuFogVolume, gpu_types::*};

/// Definitions, several at a time: a combination per line. The first line has none.
const COMBINATIONS: &str = "
ALPHA_MASKED_GEOMETRY
ALPHA_MASKED_GEOMETRY BINDLESS_TEXTURES
ROUGHNESS TILES_8
GRAZING TILE_ANGLES
COMBINED TILE_ANGLES TILE_SHAPE TILE_REFLECTANCE
IMAGE TILE_ANGLES TILE_SHAPE TILE_REFLECTANCE TILE_DEPTH
RAY_QUERY
BINDLESS_TEXTURES
RAY_QUERY BINDLESS_TEXTURES
RAY_QUERY ONE_TLAS
MIRRORS IN_PLACE COUNT_INVOCATIONS
IN_PLACE TILES
REFLECTION
RAY_QUERY MIRRORS COUNT_INVOCATIONS
RAY_QUERY BINDLESS_TEXTURES COUNT_INVOCATIONS
BOUNCES ALPHA_MASKED_GEOMETRY MANY_LIGHTS
BOUNCES MIRRORS BINDLESS_TEXTURES
BOUNCES RAY_QUERY MANY_LIGHTS
BOUNCES RAY_QUERY MIRRORS
FRONT_LAYER ALPHA_MASKED_GEOMETRY BINDLESS_TEXTURES
FRONT_LAYER IN_PLACE TILES
FRONT_LAYER RAY_QUERY IN_PLACE
PART TILES_8 FRONT_LAYER
FORWARD_SURFACES FRONT_LAYER ALPHA_MASKED_GEOMETRY BINDLESS_TEXTURES
FORWARD_SURFACES FRONT_LAYER RAY_QUERY IN_PLACE TILES
FORWARD_SURFACES FRONT_LAYER RENDER_LAYERS ALPHA_MASKED_GEOMETRY
FORWARD_SURFACES FRONT_LAYER RENDER_LAYERS RAY_QUERY
TINTED_GLASS ALPHA_MASKED_GEOMETRY BINDLESS_TEXTURES
COPLANAR TINTED_GLASS RAY_QUERY BOUNCES MANY_LIGHTS
COPLANAR TINTED_GLASS ALPHA_MASKED_GEOMETRY MIRRORS
COPLANAR
COPLANAR RAY_QUERY RENDER_LAYERS
COPLANAR LAYERED_RAYS ALPHA_MASKED_GEOMETRY MIRRORS
LAYERED_RAYS ALPHA_MASKED_GEOMETRY MIRRORS
COPLANAR LAYERED_RAYS RAY_QUERY MIRRORS TINTED_GLASS BOUNCES
COPLANAR LAYERED_RAYS REFRACTION ALPHA_MASKED_GEOMETRY MIRRORS
SURFACE_SHADER
SURFACE_SHADER RAY_QUERY BOUNCES MANY_LIGHTS LAYERED_RAYS
LAYERED_RAYS REFRACTION RAY_QUERY TINTED_GLASS BOUNCES
COPLANAR REFRACTION ALPHA_MASKED_GEOMETRY SCREEN_TRACES SCREEN_MARCH
REFRACTION RAY_QUERY TINTED_GLASS BOUNCES SURFACE_SHADER SCREEN_TRACES SCREEN_MARCH
LIGHTMAPS RAY_QUERY BINDLESS_TEXTURES
LIGHTMAPS TINTED_GLASS ALPHA_MASKED_GEOMETRY MIRRORS
CLEARCOAT BOUNCES MANY_LIGHTS
CLEARCOAT LIGHT_PROBES RAY_QUERY BINDLESS_TEXTURES
LIGHT_PROBES BINDLESS_TEXTURES TINTED_GLASS BOUNCES
LIGHT_PROBES BINDLESS_TEXTURES FRONT_LAYER IN_PLACE TILES
LIGHT_PROBES BINDLESS_TEXTURES RAY_QUERY FRONT_LAYER BLUR
LIGHT_PROBES BINDLESS_TEXTURES FORWARD_SURFACES FRONT_LAYER IN_PLACE TILES BLUR
RENDER_LAYERS ALPHA_MASKED_GEOMETRY FRONT_LAYER
RENDER_LAYERS RAY_QUERY FRONT_LAYER
LIGHT_SAMPLING MANY_LIGHTS ALPHA_MASKED_GEOMETRY
LIGHT_SAMPLING MANY_LIGHTS RAY_QUERY BOUNCES CLEARCOAT
LIGHT_SAMPLING MANY_LIGHTS RAY_QUERY MIRRORS
LIGHT_SAMPLING MANY_LIGHTS MIRRORS BOUNCES BINDLESS_TEXTURES
ATMOSPHERIC
ATMOSPHERIC RAY_QUERY BOUNCES MANY_LIGHTS CLEARCOAT
ATMOSPHERIC LIGHT_PROBES BINDLESS_TEXTURES LIGHT_SAMPLING MIRRORS
ATMOSPHERIC AERIAL_PERSPECTIVE
ATMOSPHERIC AERIAL_PERSPECTIVE RAY_QUERY BOUNCES MANY_LIGHTS LIGHT_SAMPLING
ATMOSPHERIC AERIAL_PERSPECTIVE VOLUMETRIC_FOG MIRRORS LAYERED_RAYS TINTED_GLASS BINDLESS_TEXTURES
VOLUMETRIC_FOG ALPHA_MASKED_GEOMETRY MANY_LIGHTS
VOLUMETRIC_FOG FOG_DENSITY MANY_LIGHTS
VOLUMETRIC_FOG FOG_DENSITY RAY_QUERY MIRRORS ATMOSPHERIC
VOLUMETRIC_FOG ATMOSPHERIC RAY_QUERY MIRRORS
VOLUMETRIC_FOG RAY_QUERY BOUNCES MANY_LIGHTS LIGHT_PROBES BINDLESS_TEXTURES
DIFFUSE_TRANSMISSION LIGHT_SAMPLING MANY_LIGHTS RAY_QUERY MIRRORS
DIFFUSE_TRANSMISSION RECT_LIGHTS CLEARCOAT LIGHT_PROBES BINDLESS_TEXTURES BOUNCES
RECT_LIGHTS ALPHA_MASKED_GEOMETRY LIGHT_SAMPLING MANY_LIGHTS
LIGHT_TEXTURES ATMOSPHERIC LIGHT_SAMPLING MANY_LIGHTS
LIGHT_TEXTURES RECT_LIGHTS DIFFUSE_TRANSMISSION RAY_QUERY BINDLESS_TEXTURES BOUNCES
SCREEN_TRACES ALPHA_MASKED_GEOMETRY COUNT_INVOCATIONS
SCREEN_TRACES MIRRORS
SCREEN_TRACES RAY_QUERY MIRRORS BOUNCES LAYERED_RAYS
SCREEN_TRACES SCREEN_MARCH VOLUMETRIC_FOG TINTED_GLASS
SCREEN_TRACES SCREEN_MARCH RAY_QUERY MIRRORS LAYERED_RAYS TINTED_GLASS
SCREEN_TRACES VOLUMETRIC_FOG TINTED_GLASS
SCREEN_TRACES VOLUMETRIC_FOG TINTED_GLASS RAY_QUERY BINDLESS_TEXTURES MIRRORS LIGHT_SAMPLING
RECT_LIGHTS CLEARCOAT ATMOSPHERIC RAY_QUERY BINDLESS_TEXTURES
DECALS LIGHTMAPS BOUNCES BINDLESS_TEXTURES SPECULAR_TINT
DECALS MIRRORS LAYERED_RAYS RAY_QUERY SURFACE_SHADER SPECULAR_TINT
PARTICLES ALPHA_MASKED_GEOMETRY
PARTICLES VOLUMETRIC_FOG MANY_LIGHTS RAY_QUERY
PARTICLES LIT_PARTICLES MANY_LIGHTS BOUNCES LIGHT_SAMPLING
PARTICLES LIT_PARTICLES MIRRORS LAYERED_RAYS RAY_QUERY BINDLESS_TEXTURES DIFFUSE_TRANSMISSION SCREEN_TRACES";

pub fn combinations() -> impl Iterator<Item = Vec<&'static str>> {
    COMBINATIONS.lines().map(|line| line.split_whitespace().collect())
}

/// Uses everything that passes call, so that the linker keeps it.
const USER: &str = r#"
import package::scene::types::{Ray, Hit, NO_HIT};
import package::scene::trace::trace_closest;
@if(RAY_QUERY) import package::scene::alpha_query::alpha_test;
import package::scene::surface::load_surface;
import package::scene::shading::{shade, visible_lights, MAX_LIGHTS};
import package::scene::environment::sky;
@if(LIGHT_PROBES) import package::scene::light_probes::probed_sky;
import package::scene::offset::offset_origin;

@group(0) @binding(0) var<storage, read_write> output: array<vec4<f32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let ray = Ray(vec3<f32>(0.0), 0.0, vec3<f32>(0.0, 0.0, 1.0), 1e20);
    let hit = trace_closest(ray);
    @if(!LIGHT_PROBES)
    var radiance = sky(ray.direction);
    @if(LIGHT_PROBES)
    var radiance = probed_sky(ray.origin, ray.direction);
    if hit.instance != NO_HIT {
        let surface = load_surface(hit, ray, 0.0, 0.001);
        let origin = offset_origin(surface.position, surface.geometric_normal, surface.position_scale);
        radiance = shade(surface, -ray.direction, visible_lights(surface, 0u, MAX_LIGHTS), 0.0) + origin * 0.0;
        @if(RAY_QUERY) {
        if !alpha_test(hit.instance, hit.primitive, hit.barycentrics, false) {
            radiance = vec3<f32>(0.0);
        }
        }
    }
    output[id.x] = vec4<f32>(radiance, 1.0);
}
"#;

/// Uses every struct that the CPU has, too.
const STRUCTS: &str = r#"
import package::scene::types::{Instance, Material, Light, LightProbe, SceneCounts};
import package::scene::environment::EnvironmentUniform;

@group(0) @binding(0) var<storage, read> a: Instance;
@group(0) @binding(1) var<storage, read> b: Material;
@group(0) @binding(2) var<storage, read> c: Light;
@group(0) @binding(3) var<uniform> d: SceneCounts;
@group(0) @binding(4) var<uniform> e: EnvironmentUniform;
@group(0) @binding(5) var<storage, read_write> output: array<u32>;
@group(0) @binding(6) var<storage, read> f: LightProbe;

@compute @workgroup_size(1)
fn main() {
    output[0] = a.id + b.flags + c.flags + d.light_count + e.flags + f.has_parallax;
}
"#;

#[test]
#[ignore = "long: every module with every combination of definitions"]
fn each_module_compiles_alone() {
    let mut shaders = Shaders::load();
    let mut failures = Vec::new();
    for module in shaders.own_modules() {
        for defs in combinations() {
            // Surfaces have alpha only in the front layer.
            if module.contains("/front_layer/") && !defs.contains(&"FRONT_LAYER") {
                continue;
            }
            failures.extend(shaders.compile(&module, &defs).err());
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn hit_shading_compiles_as_a_whole() {
    let mut shaders = Shaders::load();
    shaders.add("bevy_glint/user.wesl", USER.into());
    for defs in combinations() {
        let module = shaders
            .compile("bevy_glint/user.wesl", &defs)
            .unwrap_or_else(|error| panic!("{error}"));
        // Bevy's view bindings must not slip in with its functions.
        let mut bindings: Vec<_> = module
            .global_variables
            .iter()
            .filter_map(|(_, variable)| {
                variable
                    .binding
                    .as_ref()
                    .map(|binding| (binding.group, binding.binding))
            })
            .collect();
        bindings.sort();
        let count = bindings.len();
        bindings.dedup();
        assert_eq!(
            count,
            bindings.len(),
            "two variables share a binding with {defs:?}: {bindings:?}"
        );
        for (group, binding) in bindings {
            let known = match group {
                0 => binding == 0,
                1 => binding <= 12,
                2 => binding <= 8,
                _ => false,
            };
            assert!(known, "unknown binding {group}.{binding} with {defs:?}");
        }
    }
}

/// Whether the WGSL of a pass of tracing contains some names.
fn has<const N: usize>(shaders: &mut Shaders, pass: &str, defs: &[&[&'static str]], names: [&str; N]) -> [bool; N] {
    let defs: Vec<_> = defs.concat().iter().map(|&def| def.into()).collect();
    let (wgsl, _) = shaders.expect(&format!("bevy_glint/trace/{pass}.wesl"), &defs);
    names.map(|name| wgsl.contains(name))
}

/// With both tracers, passes with definitions of their own contain all of the names if `wanted` is defined, and else none.
#[track_caller]
fn assert_linked_on_request<const N: usize>(
    passes: &[(&str, &[&'static str])],
    wanted: &'static str,
    names: [&str; N],
) {
    let mut shaders = Shaders::load();
    for (pass, own) in passes {
        for tracer in [&[][..], &["RAY_QUERY"]] {
            let mut has_names = |more| has(&mut shaders, pass, &[own, tracer, more], names);
            assert_eq!(has_names(&[]), [false; N], "{pass}");
            assert_eq!(has_names(&[wanted]), [true; N], "{pass}");
        }
    }
}

/// A single bounce costs nothing: its shaders contain no code for more.
#[test]
fn bounces_are_linked_on_request() {
    let passes: [(&str, &[&str]); 4] = [
        ("blocks", &["MIRRORS"]),
        ("shade", &[]),
        ("inline", &[]),
        ("converged", &[]),
    ];
    assert_linked_on_request(&passes, "BOUNCES", ["path_radiance", "reflects_ray"]);
}

/// Shading every hit costs nothing: its shaders neither bind the screen nor look for hits on it.
#[test]
fn the_screen_is_linked_on_request() {
    let passes: [(&str, &[&str]); 3] = [("blocks", &[]), ("blocks", &["MIRRORS"]), ("shade", &["MIRRORS"])];
    let names = ["shown_light", "screen_place", "@binding(15)"];
    assert_linked_on_request(&passes, "SCREEN_TRACES", names);
}

/// Haze costs nothing in scenes without an atmosphere: their shaders neither bind its medium nor contain its code, and rays that another
/// pass shades are skipped.
#[test]
fn haze_is_linked_on_request() {
    let mut shaders = Shaders::load();
    let passes: [(&str, &[&str], bool); 4] = [
        ("shade", &[], true),
        ("blocks", &["MIRRORS"], true),
        ("converged", &[], true),
        ("blocks", &[], false),
    ];
    for (pass, own, shades) in passes {
        let names = ["ray_haze", "density_table", "multiscattering_table"];
        let mut has_haze = |more| has(&mut shaders, pass, &[own, more], names);
        assert_eq!(has_haze(&[]), [false; 3], "{pass}");
        assert_eq!(has_haze(&["ATMOSPHERIC"]), [false; 3], "{pass}");
        assert_eq!(has_haze(&["ATMOSPHERIC", "AERIAL_PERSPECTIVE"]), [shades; 3], "{pass}");
    }
}

macro_rules! same_layout {
    ($module:expr, $shader:literal, $ty:ty, [$($member:ident),* $(,)?]) => {
        let (size, members) = struct_layout(&$module, $shader).expect($shader);
        assert_eq!(size as usize, size_of::<$ty>(), "size of {}", $shader);
        let ours = vec![$((stringify!($member).to_string(), offset_of!($ty, $member) as u32)),*];
        assert_eq!(members, ours, "members of {}", $shader);
    };
}

/// A module with all of [`STRUCTS`].
fn structs() -> Arc<naga::Module> {
    let mut shaders = Shaders::load();
    shaders.add("bevy_glint/layouts.wesl", STRUCTS.into());
    shaders
        .compile("bevy_glint/layouts.wesl", &[])
        .unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn instances_and_materials_match_the_cpu() {
    let module = structs();
    same_layout!(
        module,
        "Instance",
        GpuInstance,
        [
            world_from_object,
            object_from_world,
            geometry_base,
            material,
            flags,
            id,
            masks,
            lightmap,
            lightmap_rect_or_motion
        ]
    );
    same_layout!(
        module,
        "Material",
        GpuMaterial,
        [
            base_color,
            emissive,
            textures,
            flags,
            metallic,
            perceptual_roughness,
            uv_transform,
            uv_offset,
            reflectance,
            alpha_cutoff,
            stop_probability,
            diffuse_share,
            lightmap_exposure,
            clearcoat,
            thickness,
            ior,
            optical_depth
        ]
    );
}

#[test]
fn lights_and_counts_match_the_cpu() {
    let module = structs();
    same_layout!(
        module,
        "Light",
        GpuLight,
        [
            color,
            kind,
            position,
            inverse_range_squared,
            direction,
            radius,
            spot,
            flags,
            shadow_near
        ]
    );
    same_layout!(
        module,
        "LightProbe",
        GpuLightProbe,
        [probe_from_world, falloff, intensity, parallax_bounds, has_parallax]
    );
    same_layout!(
        module,
        "SceneCounts",
        GpuSceneCounts,
        [
            light_count,
            tlas_node_count,
            tlas_root,
            moving_count,
            instance_count,
            material_count,
            texture_count,
            reflection_probe_count,
            irradiance_volume_count,
            directional_light_count,
            light_leaf_count,
            left_count,
            restless_probes,
            light_texture_count,
            first_light_texture,
            largest_depth_bias,
            depth_bias_range,
            first_particle_word,
            particle_leaf_count,
            particle_count,
            particles_move,
            first_decal_word,
            decal_leaf_count,
            decal_count
        ]
    );
}

#[test]
fn surroundings_match_the_cpu() {
    let module = structs();
    same_layout!(
        module,
        "EnvironmentUniform",
        GpuEnvironment,
        [
            ambient_color,
            exposure,
            background,
            flags,
            environment_rotation,
            skybox_rotation,
            environment_intensity,
            skybox_brightness,
            smallest_specular_mip,
            fixed_texture_level,
            air,
            fog_volumes,
            fog_ambient,
            fog_volume_count,
            fog_lamps,
            fog_lamp_count,
            aerial_distance,
            aerial_layers,
            aerial_samples
        ]
    );
    same_layout!(
        module,
        "FogVolume",
        GpuFogVolume,
        [
            volume_from_world,
            scattered,
            extinction,
            asymmetry,
            ambient_extinction,
            radius,
            textured,
            texture_offset
        ]
    );
    same_layout!(
        module,
        "Air",
        GpuAir,
        [
            air_from_world,
            sky_from_world,
            inner_radius,
            outer_radius,
            viewer_radius,
            unused
        ]
    );
}

/// Checks it with the definitions that such a shader gets for either size of tiles.
#[test]
fn the_shader_of_custom_heuristic_is_valid() {
    const NAME: &str = "custom_heuristic/foveated.wesl";
    let mut shaders = Shaders::load();
    shaders.add(NAME, include_str!("../../assets/shaders/foveated.wesl").to_owned());
    let large = ["TILE_ANGLES", "TILE_SHAPE", "TILE_REFLECTANCE", "TILE_DEPTH"];
    let small = ["TILE_ANGLES", "TILE_SHAPE", "TILE_REFLECTANCE", "TILE_DEPTH", "TILES_8"];
    for defs in [&large[..], &small[..]] {
        shaders.compile(NAME, defs).unwrap_or_else(|error| panic!("{error}"));
    }
}
