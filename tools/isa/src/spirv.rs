//! The parts of SPIR-V that a pipeline needs: stage, bindings, outputs.

use anyhow::{Context, Result, bail, ensure};
use ash::vk;
use std::collections::HashMap;
use std::ffi::CString;

/// Elements of arrays of bindings without a length.
const UNBOUNDED: u32 = 64;

/// A shader with one entry point.
#[derive(Debug)]
pub struct Shader {
    pub words: Vec<u32>,
    pub stage: vk::ShaderStageFlags,
    pub entry: CString,
    pub bindings: Vec<Binding>,
    /// Whether it has push constants.
    pub pushes: bool,
    /// Formats for the outputs of a fragment shader, by location.
    pub outputs: Vec<vk::Format>,
}

/// A resource of the shader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Binding {
    pub set: u32,
    pub binding: u32,
    pub kind: vk::DescriptorType,
    pub count: u32,
}

/// Numbers of SPIR-V's instructions.
mod op {
    pub const ENTRY_POINT: u32 = 15;
    pub const TYPE_INT: u32 = 21;
    pub const TYPE_FLOAT: u32 = 22;
    pub const TYPE_VECTOR: u32 = 23;
    pub const TYPE_IMAGE: u32 = 25;
    pub const TYPE_SAMPLER: u32 = 26;
    pub const TYPE_SAMPLED_IMAGE: u32 = 27;
    pub const TYPE_ARRAY: u32 = 28;
    pub const TYPE_RUNTIME_ARRAY: u32 = 29;
    pub const TYPE_STRUCT: u32 = 30;
    pub const TYPE_POINTER: u32 = 32;
    pub const CONSTANT: u32 = 43;
    pub const VARIABLE: u32 = 59;
    pub const DECORATE: u32 = 71;
    pub const TYPE_ACCELERATION_STRUCTURE: u32 = 5341;
}

/// Numbers of decorations.
mod decoration {
    pub const BUFFER_BLOCK: u32 = 3;
    pub const LOCATION: u32 = 30;
    pub const BINDING: u32 = 33;
    pub const SET: u32 = 34;
}

/// Numbers of storage classes.
mod class {
    pub const UNIFORM_CONSTANT: u32 = 0;
    pub const UNIFORM: u32 = 2;
    pub const OUTPUT: u32 = 3;
    pub const PUSH_CONSTANT: u32 = 9;
    pub const STORAGE_BUFFER: u32 = 12;
}

/// Numbers of images' dimensions.
mod dimension {
    pub const BUFFER: u32 = 5;
}

/// Declarations of a module by id.
#[derive(Default)]
struct Module<'a> {
    /// Operation and operands of types.
    types: HashMap<u32, (u32, &'a [u32])>,
    constants: HashMap<u32, u32>,
    decorations: HashMap<(u32, u32), u32>,
    /// Pointer type, id and storage class.
    variables: Vec<[u32; 3]>,
    entry: Option<&'a [u32]>,
}

impl Shader {
    /// Reads a module.
    pub fn read(bytes: &[u8]) -> Result<Self> {
        let (chunks, rest) = bytes.as_chunks::<4>();
        ensure!(rest.is_empty() && chunks.len() > 5, "not SPIR-V: {} bytes", bytes.len());
        let words: Vec<u32> = chunks.iter().map(|chunk| u32::from_le_bytes(*chunk)).collect();
        ensure!(words[0] == 0x0723_0203, "not SPIR-V");
        let module = Module::read(&words)?;
        let (stage, entry) = module.entry_point()?;
        let mut bindings = module.bindings()?;
        bindings.sort_by_key(|binding| (binding.set, binding.binding));
        let pushes = module
            .variables
            .iter()
            .any(|variable| variable[2] == class::PUSH_CONSTANT);
        let outputs = if stage == vk::ShaderStageFlags::FRAGMENT {
            module.outputs()?
        } else {
            Vec::new()
        };
        Ok(Self {
            stage,
            entry,
            bindings,
            pushes,
            outputs,
            words,
        })
    }
}

impl<'a> Module<'a> {
    fn read(words: &'a [u32]) -> Result<Self> {
        let mut module = Self::default();
        let mut rest = &words[5..];
        while let [first, ..] = rest {
            let (code, length) = (first & 0xffff, (first >> 16) as usize);
            ensure!(length > 0 && length <= rest.len(), "SPIR-V ends within an instruction");
            let operands = &rest[1..length];
            rest = &rest[length..];
            match (code, operands) {
                (op::ENTRY_POINT, _) => module.entry = Some(operands),
                (op::TYPE_INT..=op::TYPE_POINTER | op::TYPE_ACCELERATION_STRUCTURE, [id, others @ ..]) => {
                    module.types.insert(*id, (code, others));
                }
                (op::CONSTANT, [_, id, value, ..]) => _ = module.constants.insert(*id, *value),
                (op::DECORATE, [id, decoration, value @ ..]) => {
                    module
                        .decorations
                        .insert((*id, *decoration), value.first().copied().unwrap_or_default());
                }
                (op::VARIABLE, [ty, id, class, ..]) => module.variables.push([*ty, *id, *class]),
                _ => {}
            }
        }
        Ok(module)
    }

    fn entry_point(&self) -> Result<(vk::ShaderStageFlags, CString)> {
        let Some([model, _, name @ ..]) = self.entry else {
            bail!("no entry point")
        };
        let stage = match model {
            0 => vk::ShaderStageFlags::VERTEX,
            4 => vk::ShaderStageFlags::FRAGMENT,
            5 => vk::ShaderStageFlags::COMPUTE,
            other => bail!("unknown execution model {other}"),
        };
        let bytes = name.iter().flat_map(|word| word.to_le_bytes());
        let name = CString::new(bytes.take_while(|byte| *byte != 0).collect::<Vec<_>>())?;
        Ok((stage, name))
    }

    fn ty(&self, id: u32) -> Result<(u32, &'a [u32])> {
        self.types.get(&id).copied().context("unknown type")
    }

    /// The type that a variable's pointer leads to.
    fn pointee(&self, pointer: u32) -> Result<u32> {
        match self.ty(pointer)? {
            (op::TYPE_POINTER, [_, ty]) => Ok(*ty),
            _ => bail!("a variable is no pointer"),
        }
    }

    fn bindings(&self) -> Result<Vec<Binding>> {
        let mut bindings = Vec::new();
        for [pointer, id, class] in &self.variables {
            let decorated = |kind| self.decorations.get(&(*id, kind)).copied();
            if let (Some(set), Some(binding)) = (decorated(decoration::SET), decorated(decoration::BINDING)) {
                let (count, ty) = self.elements(self.pointee(*pointer)?)?;
                bindings.push(Binding {
                    set,
                    binding,
                    kind: self.kind(*class, ty)?,
                    count,
                });
            }
        }
        Ok(bindings)
    }

    /// The length and the element of an array of bindings.
    fn elements(&self, id: u32) -> Result<(u32, u32)> {
        Ok(match self.ty(id)? {
            (op::TYPE_ARRAY, [element, length]) => {
                (self.constants.get(length).copied().context("no length")?, *element)
            }
            (op::TYPE_RUNTIME_ARRAY, [element]) => (UNBOUNDED, *element),
            _ => (1, id),
        })
    }

    fn kind(&self, class: u32, id: u32) -> Result<vk::DescriptorType> {
        use vk::DescriptorType as Kind;
        let is_old_buffer = self.decorations.contains_key(&(id, decoration::BUFFER_BLOCK));
        Ok(match (class, self.ty(id)?) {
            (class::STORAGE_BUFFER, _) => Kind::STORAGE_BUFFER,
            (class::UNIFORM, (op::TYPE_STRUCT, _)) if is_old_buffer => Kind::STORAGE_BUFFER,
            (class::UNIFORM, _) => Kind::UNIFORM_BUFFER,
            (class::UNIFORM_CONSTANT, (op::TYPE_SAMPLER, _)) => Kind::SAMPLER,
            (class::UNIFORM_CONSTANT, (op::TYPE_SAMPLED_IMAGE, _)) => Kind::COMBINED_IMAGE_SAMPLER,
            (class::UNIFORM_CONSTANT, (op::TYPE_ACCELERATION_STRUCTURE, _)) => Kind::ACCELERATION_STRUCTURE_KHR,
            (class::UNIFORM_CONSTANT, (op::TYPE_IMAGE, [_, dimension, _, _, _, sampled, ..])) => {
                match (*dimension == dimension::BUFFER, *sampled == 2) {
                    (false, false) => Kind::SAMPLED_IMAGE,
                    (false, true) => Kind::STORAGE_IMAGE,
                    (true, false) => Kind::UNIFORM_TEXEL_BUFFER,
                    (true, true) => Kind::STORAGE_TEXEL_BUFFER,
                }
            }
            (class, (code, _)) => bail!("unknown resource: storage class {class}, type {code}"),
        })
    }

    /// Formats by location.
    fn outputs(&self) -> Result<Vec<vk::Format>> {
        let mut outputs = Vec::new();
        for [pointer, id, class] in &self.variables {
            let location = self.decorations.get(&(*id, decoration::LOCATION));
            if let (class::OUTPUT, Some(location)) = (*class, location) {
                outputs.push((*location, self.format(self.pointee(*pointer)?)?));
            }
        }
        outputs.sort_by_key(|(location, _)| *location);
        let is_dense = outputs.iter().zip(0..).all(|((location, _), index)| *location == index);
        ensure!(is_dense, "locations of outputs aren't consecutive");
        Ok(outputs.into_iter().map(|(_, format)| format).collect())
    }

    fn format(&self, id: u32) -> Result<vk::Format> {
        Ok(match self.ty(id)? {
            (op::TYPE_VECTOR, [element, _]) => self.format(*element)?,
            (op::TYPE_FLOAT, _) => vk::Format::R16G16B16A16_SFLOAT,
            (op::TYPE_INT, [_, 0]) => vk::Format::R32G32B32A32_UINT,
            (op::TYPE_INT, _) => vk::Format::R32G32B32A32_SINT,
            (code, _) => bail!("an output has type {code}"),
        })
    }
}
