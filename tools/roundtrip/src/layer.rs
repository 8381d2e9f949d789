//! A Vulkan layer that gives the driver the compute shaders of DirectX: each goes from SPIR-V to HLSL by naga, and back by Slang.
//!
//! `GLINT_LAYER_SLANG` is the path of Slang's library. A line for each compute shader is appended to the file `GLINT_LAYER_LOG`:
//! `returned NAME`, or `kept NAME: REASON` if it can't go there and back. Shaders that draw stay as they are.

mod hlsl;
mod slang;

use anyhow::{Context, Result, bail};
use ash::vk::{self, Handle};
use slang::Slang;
use std::{
    env,
    ffi::{CStr, c_char, c_void},
    fs::OpenOptions,
    io::Write,
    mem,
    path::Path,
    ptr, slice,
    sync::{LazyLock, Mutex, MutexGuard, OnceLock, PoisonError},
    thread,
};

/// Stack of a translation: both compilers descend into nested expressions.
const STACK: usize = 64 << 20;
/// `VK_STRUCTURE_TYPE_LOADER_INSTANCE_CREATE_INFO` and `VK_STRUCTURE_TYPE_LOADER_DEVICE_CREATE_INFO` of the loader's interface.
const LOADER_INSTANCE: i32 = 47;
const LOADER_DEVICE: i32 = 48;
/// `VK_LAYER_LINK_INFO`.
const LINK: u32 = 0;

type GetInstanceProc = unsafe extern "system" fn(vk::Instance, *const c_char) -> vk::PFN_vkVoidFunction;
type GetDeviceProc = unsafe extern "system" fn(vk::Device, *const c_char) -> vk::PFN_vkVoidFunction;

/// The next layer, or the driver. A process with several instances or devices has the same functions for all of them.
static NEXT_OF_INSTANCE: OnceLock<GetInstanceProc> = OnceLock::new();
static NEXT_OF_DEVICE: OnceLock<GetDeviceProc> = OnceLock::new();
static NEXT_MODULE: OnceLock<vk::PFN_vkCreateShaderModule> = OnceLock::new();

/// `VkLayerInstanceCreateInfo` and `VkLayerDeviceCreateInfo`.
#[repr(C)]
struct Chain<T> {
    kind: i32,
    next: *mut Self,
    function: u32,
    link: *mut T,
}

/// `VkLayerInstanceLink`.
#[repr(C)]
struct InstanceLink {
    next: *mut Self,
    instance_proc: GetInstanceProc,
    physical_device_proc: *const c_void,
}

/// `VkLayerDeviceLink`.
#[repr(C)]
struct DeviceLink {
    next: *mut Self,
    instance_proc: GetInstanceProc,
    device_proc: GetDeviceProc,
}

/// The compiler, which one thread uses at a time.
struct Compiler(Option<Slang>);

// SAFETY: Slang's sessions aren't bound to a thread, and the mutex admits one at a time.
unsafe impl Send for Compiler {}

static COMPILER: LazyLock<Mutex<Compiler>> = LazyLock::new(|| {
    let slang = env::var_os("GLINT_LAYER_SLANG").map(|path| Slang::load(Path::new(&path)));
    let slang = slang.and_then(Result::ok);
    if let Some(Ok(name)) = slang.as_ref().map(Slang::name) {
        log(&format!("with {name}"));
    }
    Mutex::new(Compiler(slang))
});

fn compiler() -> MutexGuard<'static, Compiler> {
    COMPILER.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The link of this layer in the loader's chain, which then names the one of the next layer.
///
/// # Safety
/// `next` must be the `pNext` that the loader passes.
unsafe fn take_link<'a, T>(next: *const c_void, kind: i32, following: fn(&T) -> *mut T) -> Option<&'a T> {
    let mut chain = next.cast_mut().cast::<Chain<T>>();
    // SAFETY: all members of the chain begin with type and `pNext`, and those of this type come from the loader.
    while let Some(info) = unsafe { chain.as_mut() } {
        if info.kind == kind && info.function == LINK {
            // SAFETY: the loader's links live as long as its call.
            let link = unsafe { info.link.as_ref() }?;
            info.link = following(link);
            return Some(link);
        }
        chain = info.next;
    }
    None
}

/// Turns a function of the next layer into its type.
///
/// # Safety
/// `T` must be the type of the function.
unsafe fn typed<T: Copy>(function: vk::PFN_vkVoidFunction) -> Option<T> {
    // SAFETY: pointers to functions have one size.
    function.map(|function| unsafe { mem::transmute_copy(&function) })
}

/// `vkCreateInstance` of this layer.
///
/// # Safety
/// Only for Vulkan's loader.
unsafe extern "system" fn create_instance(
    info: *const vk::InstanceCreateInfo<'_>,
    allocator: *const vk::AllocationCallbacks<'_>,
    instance: *mut vk::Instance,
) -> vk::Result {
    // SAFETY: the loader passes its chain, and the function has the type of its name.
    unsafe {
        let Some(link) = take_link((*info).p_next, LOADER_INSTANCE, |link: &InstanceLink| link.next) else {
            return vk::Result::ERROR_INITIALIZATION_FAILED;
        };
        let next = *NEXT_OF_INSTANCE.get_or_init(|| link.instance_proc);
        let function = next(vk::Instance::null(), c"vkCreateInstance".as_ptr());
        match typed::<vk::PFN_vkCreateInstance>(function) {
            Some(create) => create(info, allocator, instance),
            None => vk::Result::ERROR_INITIALIZATION_FAILED,
        }
    }
}

/// `vkCreateDevice` of this layer.
///
/// # Safety
/// Only for Vulkan's loader.
unsafe extern "system" fn create_device(
    adapter: vk::PhysicalDevice,
    info: *const vk::DeviceCreateInfo<'_>,
    allocator: *const vk::AllocationCallbacks<'_>,
    device: *mut vk::Device,
) -> vk::Result {
    // SAFETY: the loader passes its chain, and the functions have the types of their names.
    unsafe {
        let Some(link) = take_link((*info).p_next, LOADER_DEVICE, |link: &DeviceLink| link.next) else {
            return vk::Result::ERROR_INITIALIZATION_FAILED;
        };
        let next = *NEXT_OF_DEVICE.get_or_init(|| link.device_proc);
        let function = (link.instance_proc)(vk::Instance::null(), c"vkCreateDevice".as_ptr());
        let Some(create) = typed::<vk::PFN_vkCreateDevice>(function) else {
            return vk::Result::ERROR_INITIALIZATION_FAILED;
        };
        let result = create(adapter, info, allocator, device);
        if result == vk::Result::SUCCESS
            && let Some(module) = typed(next(*device, c"vkCreateShaderModule".as_ptr()))
        {
            NEXT_MODULE.get_or_init(|| module);
        }
        result
    }
}

/// `vkCreateShaderModule` of this layer, with another translation of the shader.
///
/// # Safety
/// Only for Vulkan's loader.
unsafe extern "system" fn create_shader_module(
    device: vk::Device,
    info: *const vk::ShaderModuleCreateInfo<'_>,
    allocator: *const vk::AllocationCallbacks<'_>,
    module: *mut vk::ShaderModule,
) -> vk::Result {
    let Some(next) = NEXT_MODULE.get() else {
        return vk::Result::ERROR_INITIALIZATION_FAILED;
    };
    // SAFETY: the app passes valid code of this size, and the new code lives until the call is over.
    unsafe {
        let mut info = *info;
        let code = slice::from_raw_parts(info.p_code, info.code_size / 4);
        let returned = go_there_and_back(code);
        if let Some(returned) = &returned {
            info.p_code = returned.as_ptr();
            info.code_size = 4 * returned.len();
        }
        next(device, &raw const info, allocator, module)
    }
}

/// The other translation of a compute shader.
fn go_there_and_back(code: &[u32]) -> Option<Vec<u32>> {
    let translated = thread::scope(|scope| {
        let thread = thread::Builder::new()
            .stack_size(STACK)
            .spawn_scoped(scope, || translate(code));
        thread.ok()?.join().ok()
    });
    let (line, returned) = match translated {
        Some((name, Ok(returned))) => (format!("returned {name}"), Some(returned)),
        Some((name, Err(error))) => (format!("kept {name}: {error:#}").replace('\n', " "), None),
        None => ("kept a shader: a compiler panicked".to_owned(), None),
    };
    log(&line);
    returned
}

/// Appends a line to the log. Shaders without a line count as missing.
fn log(line: &str) {
    if let Some(path) = env::var_os("GLINT_LAYER_LOG")
        && let Ok(mut log) = OpenOptions::new().create(true).append(true).open(path)
    {
        _ = writeln!(log, "{line}");
    }
}

/// The name of a shader's entry point, and its other translation.
fn translate(code: &[u32]) -> (String, Result<Vec<u32>>) {
    let bytes: Vec<u8> = code.iter().flat_map(|word| word.to_le_bytes()).collect();
    let shader = match glint_isa::spirv::Shader::read(&bytes) {
        Ok(shader) => shader,
        Err(error) => return ("a shader".to_owned(), Err(error)),
    };
    let entry = shader.entry.to_string_lossy().into_owned();
    let returned = || {
        if shader.stage != vk::ShaderStageFlags::COMPUTE {
            bail!("it draws");
        }
        let source = hlsl::from_spirv(&bytes, &entry)?;
        let compiler = compiler();
        let slang = compiler.0.as_ref().context("GLINT_LAYER_SLANG isn't Slang's library")?;
        glint_isa::spirv::words(&slang.compile(&slang::prepare(&source), shader.stage, &entry)?)
    };
    let returned = returned();
    (entry, returned)
}

/// The function of this layer for a name.
///
/// # Safety
/// `name` must end with a zero.
unsafe fn own(name: *const c_char) -> vk::PFN_vkVoidFunction {
    // SAFETY: names are texts that end with a zero, and Vulkan casts functions back to their own types.
    unsafe {
        let function: *const () = match CStr::from_ptr(name).to_bytes() {
            b"vkGetInstanceProcAddr" => glint_get_instance_proc_addr as GetInstanceProc as *const (),
            b"vkGetDeviceProcAddr" => glint_get_device_proc_addr as GetDeviceProc as *const (),
            b"vkCreateInstance" => create_instance as vk::PFN_vkCreateInstance as *const (),
            b"vkCreateDevice" => create_device as vk::PFN_vkCreateDevice as *const (),
            b"vkCreateShaderModule" => create_shader_module as vk::PFN_vkCreateShaderModule as *const (),
            _ => ptr::null(),
        };
        mem::transmute::<*const (), vk::PFN_vkVoidFunction>(function)
    }
}

/// Named in the layer's manifest.
///
/// # Safety
/// Only for Vulkan's loader.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn glint_get_instance_proc_addr(
    instance: vk::Instance,
    name: *const c_char,
) -> vk::PFN_vkVoidFunction {
    // SAFETY: the loader passes a name, and an instance of its own or none.
    unsafe {
        own(name).or_else(|| {
            let next = NEXT_OF_INSTANCE.get().filter(|_| !instance.is_null())?;
            next(instance, name)
        })
    }
}

/// Named in the layer's manifest.
///
/// # Safety
/// Only for Vulkan's loader.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn glint_get_device_proc_addr(
    device: vk::Device,
    name: *const c_char,
) -> vk::PFN_vkVoidFunction {
    // SAFETY: the loader passes a name, and a device that this layer created.
    unsafe { own(name).or_else(|| NEXT_OF_DEVICE.get()?(device, name)) }
}
