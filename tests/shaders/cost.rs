//! The cost of each compiled pass, against a budget in `cost.txt`: it shows that a shader grows without a GPU.
//!
//! Counts the SPIR-V of an entry point with all calls inlined, and the memory of its variables. Loops count once.

use crate::{modules::combinations, wesl::Shaders};
use bevy::shader::ShaderDefVal;
use bevy_glint::internals::passes;
use naga::{
    AddressSpace,
    back::{
        PipelineConstants,
        pipeline_constants::process_overrides,
        spv::{self, Options},
    },
    valid::{Capabilities, ModuleInfo, ValidationFlags, Validator},
};
use std::{
    collections::{BTreeMap, HashMap, HashSet},
    env,
    fmt::Write,
    fs, iter,
    ops::{Add, AddAssign},
    path::Path,
};

const FILE: &str = "tests/shaders/cost.txt";
/// Rewrites the file.
const ACCEPT: &str = "GLINT_ACCEPT_SHADER_COST";
/// Tolerance of a cost in percent of its budget.
const TOLERANCE: f64 = 3.0;

/// Definitions for scenes: the tracer, how textures are bound, and holes.
const SCENES: [&[&str]; 4] = [
    &[],
    &["BINDLESS_TEXTURES", "ALPHA_MASKED_GEOMETRY"],
    &["RAY_QUERY"],
    &["RAY_QUERY", "BINDLESS_TEXTURES"],
];

/// Passes that trace and shade, which are compiled for a scene: a pass with its definitions per line, as in the file.
const SCENE_PASSES: &str = "\
trace/blocks
trace/blocks MIRRORS
trace/blocks MIRRORS BOUNCES
trace/shade
trace/shade MIRRORS
trace/shade MANY_LIGHTS
trace/shade MANY_LIGHTS BOUNCES
trace/blocks TINTED_GLASS
trace/shade TINTED_GLASS
trace/shade LIGHTMAPS
trace/converged
trace/converged BOUNCES
trace/inline
trace/kept_rays KEPT_RAYS
trace/blocks KEPT_RAYS
trace/shade KEPT_RAYS
trace/shade MIRRORS KEPT_RAYS
front_layer/find FRONT_LAYER";

/// All others, and passes for scenes with rare features.
const PASSES: &str = "\
front_layer/find FRONT_LAYER FORWARD_SURFACES ALPHA_MASKED_GEOMETRY
front_layer/find FRONT_LAYER FORWARD_SURFACES RAY_QUERY
trace/shade VOLUMETRIC_FOG FOG_DENSITY MANY_LIGHTS
trace/blocks VOLUMETRIC_FOG FOG_DENSITY MIRRORS RAY_QUERY
trace/shade VOLUMETRIC_FOG MANY_LIGHTS
trace/blocks VOLUMETRIC_FOG MIRRORS RAY_QUERY
trace/blocks DIFFUSE_TRANSMISSION
trace/shade DIFFUSE_TRANSMISSION
trace/shade RECT_LIGHTS
trace/shade RECT_LIGHTS CLEARCOAT RAY_QUERY BINDLESS_TEXTURES
trace/shade LIGHT_TEXTURES
trace/shade LIGHT_TEXTURES RAY_QUERY BINDLESS_TEXTURES
trace/shade CLEARCOAT
trace/shade CLEARCOAT RAY_QUERY BINDLESS_TEXTURES
trace/shade LIGHT_PROBES BINDLESS_TEXTURES ALPHA_MASKED_GEOMETRY
trace/shade LIGHT_PROBES RAY_QUERY BINDLESS_TEXTURES
trace/blocks LIGHT_PROBES BINDLESS_TEXTURES ALPHA_MASKED_GEOMETRY
trace/blocks LIGHT_PROBES RAY_QUERY BINDLESS_TEXTURES
trace/blocks LIGHT_SAMPLING
trace/blocks LIGHT_SAMPLING MIRRORS
trace/blocks LIGHT_SAMPLING MIRRORS RAY_QUERY
trace/shade LIGHT_SAMPLING MANY_LIGHTS
trace/shade LIGHT_SAMPLING MANY_LIGHTS RAY_QUERY
trace/shade LIGHT_SAMPLING MANY_LIGHTS BOUNCES
trace/converged LIGHT_SAMPLING
trace/blocks COPLANAR
trace/blocks COPLANAR RAY_QUERY
trace/blocks COPLANAR MIRRORS LAYERED_RAYS ALPHA_MASKED_GEOMETRY
trace/blocks COPLANAR MIRRORS LAYERED_RAYS RAY_QUERY
trace/blocks MIRRORS LAYERED_RAYS ALPHA_MASKED_GEOMETRY
trace/blocks MIRRORS LAYERED_RAYS RAY_QUERY
trace/blocks MIRRORS LAYERED_RAYS REFRACTION ALPHA_MASKED_GEOMETRY
trace/converged LAYERED_RAYS REFRACTION RAY_QUERY TINTED_GLASS
trace/blocks REFRACTION ALPHA_MASKED_GEOMETRY
trace/blocks REFRACTION RAY_QUERY TINTED_GLASS
trace/inline REFRACTION RAY_QUERY TINTED_GLASS
trace/shade SURFACE_SHADER
trace/blocks ATMOSPHERIC
trace/blocks ATMOSPHERIC MIRRORS RAY_QUERY
trace/shade ATMOSPHERIC
trace/converged ATMOSPHERIC RAY_QUERY
trace/shade ATMOSPHERIC AERIAL_PERSPECTIVE
trace/blocks ATMOSPHERIC AERIAL_PERSPECTIVE MIRRORS RAY_QUERY
trace/converged ATMOSPHERIC AERIAL_PERSPECTIVE RAY_QUERY
trace/blocks RENDER_LAYERS
trace/blocks RENDER_LAYERS RAY_QUERY
trace/blocks SCREEN_TRACES
trace/blocks SCREEN_TRACES RAY_QUERY
trace/blocks SCREEN_TRACES MIRRORS RAY_QUERY
trace/shade SCREEN_TRACES MIRRORS
trace/blocks SCREEN_TRACES SCREEN_MARCH
trace/blocks SCREEN_TRACES SCREEN_MARCH MIRRORS RAY_QUERY
trace/shade PARTICLES
trace/shade PARTICLES LIT_PARTICLES MANY_LIGHTS RAY_QUERY
trace/blocks PARTICLES MIRRORS
trace/blocks PARTICLES LIT_PARTICLES
trace/shade DECALS
trace/shade SPECULAR_TINT
composite/screen
rate/classify
rate/classify ROUGHNESS
rate/classify GRAZING TILE_ANGLES
rate/classify COMBINED TILE_ANGLES TILE_SHAPE TILE_REFLECTANCE
rate/classify COMBINED TILE_ANGLES TILE_SHAPE TILE_REFLECTANCE TILES_8
rate/classify IMAGE
rate/adaptive TILE_ANGLES TILE_SHAPE TILE_REFLECTANCE
denoise/reconstruct
denoise/reconstruct WIDE
denoise/reconstruct WIDE REST
denoise/temporal
denoise/temporal REST
denoise/temporal HIT_MOTION
denoise/temporal LIGHT_CHANGES
denoise/one_pass
denoise/one_pass REST
denoise/one_pass HIT_MOTION
denoise/one_pass WIDE
denoise/one_pass WIDE REST
denoise/one_pass WIDE HIT_MOTION
denoise/one_pass WIDE HIT_MOTION LIGHT_CHANGES
composite/resolve
composite/resolve IN_PLACE
composite/resolve IN_PLACE TILES
composite/resolve IN_PLACE TILES BLUR
composite/resolve IN_PLACE TILES FRONT_LAYER
composite/resolve IN_PLACE TILES FRONT_LAYER BLUR
composite/resolve HALF_RESOLUTION BLUR
composite/resolve IN_PLACE TILES HALF_RESOLUTION
composite/resolve IN_PLACE TILES HALF_RESOLUTION BLUR
composite/resolve IN_PLACE TILES FRONT_LAYER HALF_RESOLUTION BLUR
composite/resolve IN_PLACE TILES FRONT_LAYER LIGHT_PROBES BINDLESS_TEXTURES
composite/resolve IN_PLACE TILES FRONT_LAYER FORWARD_SURFACES
composite/add
trace/vrs
scene/pose/pose
scene/pose/pose VERTEX_SHADER
scene/pose/refit
scene/scatter
scene/texture_layers
debug/count
debug/show
debug/show REFLECTION
debug/show REFLECTION BLUR
debug/show REFLECTION BLUR HALF_RESOLUTION
guides/guides";

/// Names of the columns.
const COLUMNS: [&str; 5] = [
    "instructions",
    "texture loads",
    "buffer loads",
    "private bytes",
    "workgroup bytes",
];

/// A number for each of [`COLUMNS`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Cost([u32; COLUMNS.len()]);

impl Add for Cost {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        let mut sum = self;
        sum += other;
        sum
    }
}

impl AddAssign for Cost {
    fn add_assign(&mut self, other: Self) {
        iter::zip(&mut self.0, other.0).for_each(|(sum, more)| *sum += more);
    }
}

/// Costs by name of pass and definitions.
type Costs = BTreeMap<String, Cost>;

/// Numbers of SPIR-V's instructions and storage classes.
mod op {
    use std::ops::RangeInclusive;

    pub const TYPE_POINTER: u16 = 32;
    pub const FUNCTION: u16 = 54;
    pub const FUNCTION_END: u16 = 56;
    pub const FUNCTION_CALL: u16 = 57;
    pub const VARIABLE: u16 = 59;
    pub const LOAD: u16 = 61;
    /// Declarations within functions, which don't execute: parameters, variables and labels.
    pub const SILENT: [u16; 4] = [55, VARIABLE, 248, 317];
    /// Samples, fetches, gathers and reads.
    pub const IMAGE_LOADS: RangeInclusive<u16> = 87..=98;
    /// Uniforms and storage buffers.
    pub const BUFFERS: [u32; 2] = [2, 12];
}

/// A function's own cost, and the functions that it calls.
#[derive(Default)]
struct Function {
    own: Cost,
    calls: Vec<u32>,
}

fn inlined(id: u32, functions: &HashMap<u32, Function>) -> Cost {
    let function = &functions[&id];
    let calls = function.calls.iter().map(|callee| inlined(*callee, functions));
    calls.fold(function.own, Cost::add)
}

/// Cost of the functions of SPIR-V, by name.
fn functions(words: &[u32]) -> HashMap<u32, Function> {
    let mut functions = HashMap::<u32, Function>::new();
    // Storage classes of pointer types, and result types of instructions.
    let (mut classes, mut types) = (HashMap::new(), HashMap::new());
    let mut current = None;
    let mut rest = &words[5..];
    while let [first, ..] = rest {
        let (instruction, others) = rest.split_at((first >> 16) as usize);
        rest = others;
        let code = *first as u16;
        match (code, instruction) {
            (op::TYPE_POINTER, [_, id, class, ..]) => _ = classes.insert(*id, *class),
            (op::VARIABLE, [_, kind, id, ..]) => _ = types.insert(*id, *kind),
            (op::FUNCTION, [_, _, id, ..]) => current = Some(*id),
            (op::FUNCTION_END, _) => current = None,
            _ => {}
        }
        let Some(id) = current else { continue };
        if let [_, kind, result, ..] = instruction
            && classes.contains_key(kind)
        {
            types.insert(*result, *kind);
        }
        let function = functions.entry(id).or_default();
        if code == op::FUNCTION || op::SILENT.contains(&code) {
            continue;
        }
        let [instructions, image_loads, buffer_loads, ..] = &mut function.own.0;
        *instructions += 1;
        match (code, instruction) {
            (op::FUNCTION_CALL, [_, _, _, callee, ..]) => function.calls.push(*callee),
            (op::LOAD, [_, _, _, pointer, ..]) => {
                let class = types.get(pointer).and_then(|kind| classes.get(kind));
                *buffer_loads += u32::from(class.is_some_and(|class| op::BUFFERS.contains(class)));
            }
            _ => *image_loads += u32::from(op::IMAGE_LOADS.contains(&code)),
        }
    }
    functions
}

/// The id of the only entry point.
fn entry_point(words: &[u32]) -> u32 {
    const ENTRY_POINT: u16 = 15;
    let mut rest = &words[5..];
    while let [first, ..] = rest {
        if *first as u16 == ENTRY_POINT {
            return rest[2];
        }
        rest = &rest[(first >> 16) as usize..];
    }
    panic!("SPIR-V without an entry point");
}

/// Bytes of a module's variables in an address space, including function variables.
fn bytes(module: &naga::Module, space: AddressSpace) -> u32 {
    let size = |ty: naga::Handle<naga::Type>| module.types[ty].inner.size(module.to_ctx());
    let globals = module
        .global_variables
        .iter()
        .filter(|(_, global)| global.space == space);
    let mut sum: u32 = globals.map(|(_, global)| size(global.ty)).sum();
    if space == AddressSpace::Private {
        let entries = module.entry_points.iter().map(|entry| &entry.function);
        let functions = module.functions.iter().map(|(_, function)| function).chain(entries);
        let locals = functions.flat_map(|function| function.local_variables.iter());
        sum += locals.map(|(_, local)| size(local.ty)).sum::<u32>();
    }
    sum
}

/// The cost of all entry points of a module.
fn cost(module: &naga::Module, info: &ModuleInfo) -> Result<Cost, String> {
    // Without run-time checks, as Bevy compiles.
    let options = Options {
        lang_version: (1, 5),
        flags: spv::WriterFlags::empty(),
        zero_initialize_workgroup_memory: spv::ZeroInitializeWorkgroupMemoryMode::None,
        force_loop_bounding: false,
        ray_query_initialization_tracking: false,
        emit_int_div_checks: false,
        ..Options::default()
    };
    let mut sum = Cost([
        0,
        0,
        0,
        bytes(module, AddressSpace::Private),
        bytes(module, AddressSpace::WorkGroup),
    ]);
    // Any number works for constants that get their value later.
    let overrides = module.overrides.iter();
    let constants: PipelineConstants = overrides
        .filter_map(|(_, constant)| Some((constant.name.clone()?, 4.0)))
        .collect();
    for entry in &module.entry_points {
        let (module, info) = process_overrides(module, info, Some((entry.stage, &entry.name)), &constants)
            .map_err(|error| error.to_string())?;
        let stage = spv::PipelineOptions {
            shader_stage: entry.stage,
            entry_point: entry.name.clone(),
        };
        let words = spv::write_vec(&module, &info, &options, Some(&stage)).map_err(|error| error.to_string())?;
        sum += inlined(entry_point(&words), &functions(&words));
    }
    Ok(sum)
}

/// The passes, each with the definitions of a variant.
pub fn variants() -> impl Iterator<Item = (&'static str, Vec<&'static str>)> {
    let of_line = |line: &'static str| {
        let mut words = line.split_whitespace();
        (words.next().expect("a line names a pass"), words.collect::<Vec<_>>())
    };
    let of_scenes = SCENE_PASSES
        .lines()
        .map(of_line)
        .flat_map(|(pass, own)| SCENES.map(|scene| (pass, [&own, scene].concat())));
    of_scenes.chain(PASSES.lines().map(of_line))
}

/// Measures the costs of the current shaders.
fn measure() -> Costs {
    let mut shaders = Shaders::load();
    let mut costs = Costs::new();
    for (pass, names) in variants() {
        let defs: Vec<ShaderDefVal> = names.iter().map(|name| (*name).into()).collect();
        let (_, module) = shaders.expect(&format!("bevy_glint/{pass}.wesl"), &defs);
        let info = Validator::new(ValidationFlags::all(), Capabilities::all()).validate(&module);
        let name = iter::once(pass).chain(names).collect::<Vec<_>>().join(" ");
        let cost = cost(&module, &info.expect("it was validated before"));
        let cost = cost.unwrap_or_else(|error| panic!("{name}: {error}"));
        costs.insert(name, cost);
    }
    costs
}

fn to_text(costs: &Costs) -> String {
    let mut text = format!("# pass and definitions: {}\n", COLUMNS.join(", "));
    for (name, cost) in costs {
        let numbers = cost.0.map(|number| format!("{number:>6}")).join(" ");
        writeln!(text, "{name:<75} {numbers}").expect("text can be written");
    }
    text
}

fn from_text(text: &str) -> Costs {
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    let costs = lines.map(|line| {
        let (names, numbers): (Vec<_>, Vec<_>) = line
            .split_whitespace()
            .partition(|word| !word.starts_with(|first: char| first.is_ascii_digit()));
        let numbers: Vec<u32> = numbers.iter().filter_map(|number| number.parse().ok()).collect();
        let cost = numbers.try_into().unwrap_or_else(|_| panic!("{FILE}: {line}"));
        (names.join(" "), Cost(cost))
    });
    costs.collect()
}

/// The differences that are too large, a line each.
fn changes(budget: &Costs, measured: &Costs) -> Vec<String> {
    let mut changes = Vec::new();
    for (name, cost) in measured {
        let Some(allowed) = budget.get(name) else {
            changes.push(format!("{name}: not in the budget"));
            continue;
        };
        for ((column, allowed), found) in COLUMNS.iter().zip(allowed.0).zip(cost.0) {
            let change = 100.0 * (f64::from(found) - f64::from(allowed)) / f64::from(allowed.max(1));
            if change.abs() > TOLERANCE {
                changes.push(format!("{name}: {column}: {allowed} -> {found} ({change:+.1} %)"));
            }
        }
    }
    let gone = budget.keys().filter(|name| !measured.contains_key(*name));
    changes.extend(gone.map(|name| format!("{name}: no such pass")));
    changes
}

#[test]
fn all_passes_have_a_budget() {
    let known: HashSet<_> = variants().map(|(pass, _)| format!("{pass}.wesl")).collect();
    let missing: Vec<_> = passes::modules().filter(|module| !known.contains(*module)).collect();
    assert!(missing.is_empty(), "{missing:?}");
}

#[test]
fn all_definitions_are_compiled_in_some_combination() {
    let of_passes = variants().flat_map(|(_, definitions)| definitions);
    let tried: HashSet<_> = combinations().flatten().chain(of_passes).collect();
    let missing: Vec<_> = passes::definitions().filter(|name| !tried.contains(name)).collect();
    assert!(missing.is_empty(), "{missing:?}");
}

#[test]
fn passes_keep_to_their_budget() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(FILE);
    let measured = measure();
    if env::var_os(ACCEPT).is_some() {
        fs::write(&file, to_text(&measured)).expect("the budget can be written");
        return;
    }
    let budget = from_text(&fs::read_to_string(&file).expect("there is a budget"));
    let changes = changes(&budget, &measured);
    assert!(
        changes.is_empty(),
        "costs of shaders that differ from {FILE} by more than {TOLERANCE} %:\n{}\n\nIf they are worth it, run \
         `{ACCEPT}=1 cargo xtask test -- passes_keep_to_their_budget` and commit the file.",
        changes.join("\n")
    );
}

#[test]
fn changes_are_told_apart_from_noise() {
    let costs = |instructions: u32| Costs::from([("blur TILES".to_owned(), Cost([instructions, 4, 0, 64, 0]))]);
    let budget = costs(1000);
    assert_eq!(from_text(&to_text(&budget)), budget);
    assert_eq!(changes(&budget, &costs(1030)), [""; 0]);
    assert_eq!(
        changes(&budget, &costs(960)),
        ["blur TILES: instructions: 1000 -> 960 (-4.0 %)"]
    );
    assert_eq!(changes(&Costs::new(), &budget), ["blur TILES: not in the budget"]);
    assert_eq!(changes(&budget, &Costs::new()), ["blur TILES: no such pass"]);
}
