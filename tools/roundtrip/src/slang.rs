//! Slang's compiler for HLSL, through the C functions of its library.

use anyhow::{Context, Result, bail, ensure};
use ash::vk;
use libloading::{Library, Symbol};
use std::collections::{HashMap, HashSet};
use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::path::Path;
use std::ptr;

/// Slang's numbers for the target and the source language.
const SPIRV: c_int = 6;
const HLSL: c_int = 2;
/// SPIR-V gets the names of entry points, and the bindings of HLSL's registers: each resource of our passes has its own number, so classes
/// of registers don't collide. Layouts of buffers are those of DirectX.
const OPTIONS: &str = "-emit-spirv-directly -capability spirv_1_5 -fvk-use-entrypoint-name -fvk-use-dx-layout \
    -fvk-b-shift 0 all -fvk-t-shift 0 all -fvk-u-shift 0 all -fvk-s-shift 0 all";

/// Replaces what Slang doesn't know. Constants with a sampler that is looked up in a heap become samplers with a register, the one in the
/// index, and arrays of them become arrays. Vectors that are stored to textures with one component become scalars, which other compilers do
/// themselves.
pub fn prepare(source: &str) -> String {
    let scalars: HashSet<_> = source.lines().filter_map(scalar_texture).collect();
    let arrays: HashMap<_, _> = source
        .lines()
        .filter_map(|line| heap_use(line).map(|found| (found.name, found.group)))
        .collect();
    let mut text = String::with_capacity(source.len());
    for line in source.lines() {
        if let Some((kind, name, group, register)) = sampler(line) {
            text.push_str(&format!("{kind} {name} : register(s{register}, space{group});\n"));
        } else if let Some((name, register)) = constant(line)
            && let Some(group) = arrays.get(name)
        {
            text.push_str(&format!(
                "SamplerState {name}[] : register(s{register}, space{group});\n"
            ));
        } else if let Some(HeapUse {
            before,
            name,
            index,
            after,
            ..
        }) = heap_use(line)
        {
            text.push_str(&format!("{before}{name}[NonUniformResourceIndex({index})]{after}\n"));
        } else if let Some((target, value)) = store(line, &scalars) {
            text.push_str(&format!("{target} = ({value}).x;\n"));
        } else {
            text.push_str(line);
            text.push('\n');
        }
    }
    text
}

/// A sampler that is taken from the heap by an index in an array.
#[derive(Debug, PartialEq)]
struct HeapUse<'a> {
    before: &'a str,
    /// The constant with the array's first index.
    name: &'a str,
    group: u32,
    index: &'a str,
    after: &'a str,
}

/// Finds `nagaSamplerHeap[NonUniformResourceIndex(nagaGroup1SamplerIndexArray[first + index])]`.
fn heap_use(line: &str) -> Option<HeapUse<'_>> {
    let (before, rest) = line.split_once("nagaSamplerHeap[NonUniformResourceIndex(nagaGroup")?;
    let (group, rest) = rest.split_once("SamplerIndexArray[")?;
    let (name, rest) = rest.split_once(" + ")?;
    let mut depth = 0;
    let end = rest.find(|letter| {
        depth += i32::from(letter == '[') - i32::from(letter == ']');
        depth < 0
    })?;
    let (index, after) = rest.split_at(end);
    Some(HeapUse {
        before,
        name,
        group: group.parse().ok()?,
        index,
        after: after.strip_prefix("])]")?,
    })
}

/// Name and value of `static const uint a = 7;`.
fn constant(line: &str) -> Option<(&str, u32)> {
    let (name, value) = line.strip_prefix("static const uint ")?.split_once(" = ")?;
    Some((name, value.strip_suffix(';')?.parse().ok()?))
}

/// The name of a texture with one component that can be written.
fn scalar_texture(line: &str) -> Option<&str> {
    let (_, rest) = line.strip_prefix("RWTexture")?.split_once('<')?;
    let (kind, rest) = rest.split_once("> ")?;
    ["uint", "int", "float"]
        .contains(&kind)
        .then(|| rest.split([' ', ':', ';']).next())?
}

/// The target and the value of a store to one of these textures.
fn store<'a>(line: &'a str, textures: &HashSet<&str>) -> Option<(&'a str, &'a str)> {
    let (target, value) = line.split_once(" = ")?;
    let (name, _) = target.trim_start().split_once('[')?;
    textures.contains(name).then_some(())?;
    Some((target, value.strip_suffix(';')?))
}

/// Type, name, group and register of `static const SamplerState a = nagaSamplerHeap[nagaGroup0SamplerIndexArray[5]];`.
fn sampler(line: &str) -> Option<(&str, &str, u32, u32)> {
    let (kind, rest) = line.strip_prefix("static const Sampler")?.split_once(' ')?;
    let kind = match kind {
        "State" => "SamplerState",
        "ComparisonState" => "SamplerComparisonState",
        _ => return None,
    };
    let (name, value) = rest.split_once(" = ")?;
    let (_, index) = value.split_once("[nagaGroup")?;
    let (group, register) = index.strip_suffix("]];")?.split_once("SamplerIndexArray[")?;
    Some((kind, name, group.parse().ok()?, register.parse().ok()?))
}

/// A session of the compiler, which ends with the program.
pub struct Slang {
    library: Library,
    session: *mut c_void,
}

/// A request that is destroyed at the end.
struct Request<'a> {
    slang: &'a Slang,
    handle: *mut c_void,
}

type Create = unsafe extern "C" fn(*mut c_void) -> *mut c_void;
type Destroy = unsafe extern "C" fn(*mut c_void);

impl Slang {
    /// Opens the library.
    pub fn load(path: &Path) -> Result<Self> {
        // SAFETY: initialisers of Slang's library have no requirements.
        let library = unsafe { Library::new(path) }.with_context(|| path.display().to_string())?;
        // SAFETY: the type is the one of Slang's header; it takes a null pointer.
        let session = unsafe { library.get::<Create>(b"spCreateSession\0")?(ptr::null_mut()) };
        ensure!(!session.is_null(), "Slang makes no session");
        Ok(Self { library, session })
    }

    /// Name and version.
    pub fn name(&self) -> Result<String> {
        // SAFETY: the type is the one of Slang's header, and the text is static.
        let version = unsafe {
            let tag: Symbol<unsafe extern "C" fn() -> *const c_char> = self.library.get(b"spGetBuildTagString\0")?;
            CStr::from_ptr(tag())
        };
        Ok(format!("Slang {}", version.to_string_lossy()))
    }

    /// Compiles an entry point to SPIR-V.
    pub fn compile(&self, source: &str, stage: vk::ShaderStageFlags, entry: &str) -> Result<Vec<u8>> {
        let (source, entry) = (CString::new(source)?, CString::new(entry)?);
        let options: Vec<_> = OPTIONS.split(' ').map(CString::new).collect::<Result<_, _>>()?;
        let options: Vec<_> = options.iter().map(|option| option.as_ptr()).collect();
        let stage = match stage {
            vk::ShaderStageFlags::VERTEX => 1,
            vk::ShaderStageFlags::FRAGMENT => 5,
            _ => 6,
        };
        // SAFETY: the types are those of Slang's header, all texts end with a zero and live until the request is destroyed.
        unsafe {
            let request = self.request()?;
            let set_target: Symbol<unsafe extern "C" fn(*mut c_void, c_int)> =
                self.library.get(b"spSetCodeGenTarget\0")?;
            set_target(request.handle, SPIRV);
            let process: Symbol<unsafe extern "C" fn(*mut c_void, *const *const c_char, c_int) -> i32> =
                self.library.get(b"spProcessCommandLineArguments\0")?;
            if process(request.handle, options.as_ptr(), options.len() as c_int) < 0 {
                bail!("Slang refuses its options: {}", request.diagnostics()?);
            }
            let add_unit: Symbol<unsafe extern "C" fn(*mut c_void, c_int, *const c_char) -> c_int> =
                self.library.get(b"spAddTranslationUnit\0")?;
            let unit = add_unit(request.handle, HLSL, c"pass".as_ptr());
            let add_source: Symbol<unsafe extern "C" fn(*mut c_void, c_int, *const c_char, *const c_char)> =
                self.library.get(b"spAddTranslationUnitSourceString\0")?;
            add_source(request.handle, unit, c"pass.hlsl".as_ptr(), source.as_ptr());
            let add_entry: Symbol<unsafe extern "C" fn(*mut c_void, c_int, *const c_char, c_int) -> c_int> =
                self.library.get(b"spAddEntryPoint\0")?;
            let index = add_entry(request.handle, unit, entry.as_ptr(), stage);
            let compile: Symbol<unsafe extern "C" fn(*mut c_void) -> i32> = self.library.get(b"spCompile\0")?;
            if compile(request.handle) < 0 {
                bail!("{}", request.diagnostics()?);
            }
            let code: Symbol<unsafe extern "C" fn(*mut c_void, c_int, *mut usize) -> *const u8> =
                self.library.get(b"spGetEntryPointCode\0")?;
            let mut size = 0;
            let bytes = code(request.handle, index, &raw mut size);
            ensure!(!bytes.is_null() && size > 0, "Slang writes no code");
            Ok(without_language(std::slice::from_raw_parts(bytes, size)))
        }
    }

    /// Begins a request.
    ///
    /// # Safety
    /// The library must be Slang's.
    unsafe fn request(&self) -> Result<Request<'_>> {
        // SAFETY: the type is the one of Slang's header, and the session is alive.
        let handle = unsafe { self.library.get::<Create>(b"spCreateCompileRequest\0")?(self.session) };
        ensure!(!handle.is_null(), "Slang makes no request");
        Ok(Request { slang: self, handle })
    }
}

impl Request<'_> {
    /// Errors without warnings, shortened.
    fn diagnostics(&self) -> Result<String> {
        // SAFETY: the type is the one of Slang's header, and the text lives as long as the request.
        let text = unsafe {
            let diagnostics: Symbol<unsafe extern "C" fn(*mut c_void) -> *const c_char> =
                self.slang.library.get(b"spGetDiagnosticOutput\0")?;
            let text = diagnostics(self.handle);
            ensure!(!text.is_null(), "no reason given");
            CStr::from_ptr(text).to_string_lossy().into_owned()
        };
        Ok(errors(&text))
    }
}

/// SPIR-V that doesn't tell its source language: older validators don't know Slang's number.
fn without_language(code: &[u8]) -> Vec<u8> {
    const SOURCE: u32 = 3;
    let mut code = code.to_vec();
    let (words, _) = code.as_chunks_mut::<4>();
    let mut at = 5;
    while let Some(first) = words.get(at).map(|word| u32::from_le_bytes(*word)) {
        if first & 0xffff == SOURCE
            && let Some(language) = words.get_mut(at + 1)
        {
            *language = [0; 4];
        }
        at += (first >> 16).max(1) as usize;
    }
    code
}

/// The first errors among diagnostics, with the lines that they show.
fn errors(text: &str) -> String {
    const LINES: usize = 12;
    let begins = |line: &&str| line.starts_with("error") || line.starts_with("fatal");
    let lines: Vec<_> = text.lines().skip_while(|line| !begins(line)).take(LINES).collect();
    if lines.is_empty() {
        text.to_owned()
    } else {
        lines.join("\n")
    }
}

impl Drop for Request<'_> {
    fn drop(&mut self) {
        // SAFETY: the type is the one of Slang's header, and nothing uses the request any more.
        unsafe {
            if let Ok(destroy) = self.slang.library.get::<Destroy>(b"spDestroyCompileRequest\0") {
                destroy(self.handle);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samplers_get_registers() {
        let line = "static const SamplerState layer_sampler = nagaSamplerHeap[nagaGroup1SamplerIndexArray[9]];";
        assert_eq!(sampler(line), Some(("SamplerState", "layer_sampler", 1, 9)));
        let line =
            "static const SamplerComparisonState a_1 = nagaComparisonSamplerHeap[nagaGroup0SamplerIndexArray[2]];";
        assert_eq!(sampler(line), Some(("SamplerComparisonState", "a_1", 0, 2)));
        for other in [
            "static const uint samplers = 9;",
            "SamplerState nagaSamplerHeap[2048]: register(s0, space0);",
        ] {
            assert_eq!(sampler(other), None, "{other}");
        }
    }

    #[test]
    fn arrays_of_samplers_become_arrays() {
        let source = "static const uint samplers = 7;
static const uint other = 8;
    c = t[i].SampleLevel(nagaSamplerHeap[NonUniformResourceIndex(nagaGroup1SamplerIndexArray[samplers + min(a[2], 31u)])], uv);
";
        let expected = "SamplerState samplers[] : register(s7, space1);
static const uint other = 8;
    c = t[i].SampleLevel(samplers[NonUniformResourceIndex(min(a[2], 31u))], uv);
";
        assert_eq!(prepare(source), expected);
    }

    #[test]
    fn only_what_slang_refuses_changes() {
        let source = "static const SamplerState a = nagaSamplerHeap[nagaGroup1SamplerIndexArray[9]];
RWTexture2D<uint> rates : register(u5);
RWTexture2D<float4> colors : register(u6);
    rates[id_1] = uint4(_e96, 0u, 0u, 0u);
    colors[id_1] = float4(_e97);
    rates_1 = rates;
";
        let expected = "SamplerState a : register(s9, space1);
RWTexture2D<uint> rates : register(u5);
RWTexture2D<float4> colors : register(u6);
    rates[id_1] = (uint4(_e96, 0u, 0u, 0u)).x;
    colors[id_1] = float4(_e97);
    rates_1 = rates;
";
        assert_eq!(prepare(source), expected);
    }

    #[test]
    fn the_language_is_removed() {
        let words = [0, 0, 0, 0, 0, 2 << 16 | 17, 1, 3 << 16 | 3, 11, 1, 1 << 16];
        let code: Vec<u8> = words.iter().flat_map(|word: &u32| word.to_le_bytes()).collect();
        let mut expected = code.clone();
        expected[8 * 4] = 0;
        assert_eq!(without_language(&code), expected);
    }

    #[test]
    fn errors_come_without_warnings() {
        let text = "warning[E1]: a\n --> b\nerror[E2]: c\n --> d\n";
        assert_eq!(errors(text), "error[E2]: c\n --> d");
        assert_eq!(errors("odd"), "odd");
    }
}
