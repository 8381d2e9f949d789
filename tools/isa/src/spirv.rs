//! The parts of SPIR-V that a pipeline needs: stage, bindings, outputs.

use anyhow::{Context, Result, bail, ensure};
use ash::vk;
use spirv::{Decoration, Dim, ExecutionModel, MAGIC_NUMBER, Op, StorageClass};
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

/// Declarations of a module by id.
#[derive(Default)]
struct Module<'a> {
    /// Operation and operands of types.
    types: HashMap<u32, (Op, &'a [u32])>,
    constants: HashMap<u32, u32>,
    decorations: HashMap<(u32, u32), u32>,
    /// Pointer type, id and storage class.
    variables: Vec<(u32, u32, StorageClass)>,
    entry: Option<&'a [u32]>,
}

/// The words of a module.
pub fn words(bytes: &[u8]) -> Result<Vec<u32>> {
    let (chunks, rest) = bytes.as_chunks::<4>();
    ensure!(rest.is_empty() && chunks.len() > 5, "not SPIR-V: {} bytes", bytes.len());
    let words: Vec<u32> = chunks.iter().map(|chunk| u32::from_le_bytes(*chunk)).collect();
    ensure!(words[0] == MAGIC_NUMBER, "not SPIR-V");
    Ok(words)
}

impl Shader {
    /// Reads a module.
    pub fn read(bytes: &[u8]) -> Result<Self> {
        let words = words(bytes)?;
        let module = Module::read(&words)?;
        let (stage, entry) = module.entry_point()?;
        let bindings = module.bindings()?;
        let pushed = |variable: &(u32, u32, StorageClass)| variable.2 == StorageClass::PushConstant;
        let pushes = module.variables.iter().any(pushed);
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
            match (Op::from_u32(code), operands) {
                (Some(Op::EntryPoint), _) => module.entry = Some(operands),
                (Some(Op::Constant), [_, id, value, ..]) => _ = module.constants.insert(*id, *value),
                (Some(Op::Decorate), [id, decoration, value @ ..]) => {
                    let value = value.first().copied().unwrap_or_default();
                    module.decorations.insert((*id, *decoration), value);
                }
                (Some(Op::Variable), [ty, id, class, ..]) => {
                    let class = StorageClass::from_u32(*class).context("unknown storage class")?;
                    module.variables.push((*ty, *id, class));
                }
                (Some(op), [id, others @ ..]) if op.is_type() => _ = module.types.insert(*id, (op, others)),
                _ => {}
            }
        }
        Ok(module)
    }

    fn entry_point(&self) -> Result<(vk::ShaderStageFlags, CString)> {
        let Some([model, _, name @ ..]) = self.entry else {
            bail!("no entry point")
        };
        let stage = match ExecutionModel::from_u32(*model) {
            Some(ExecutionModel::Vertex) => vk::ShaderStageFlags::VERTEX,
            Some(ExecutionModel::Fragment) => vk::ShaderStageFlags::FRAGMENT,
            Some(ExecutionModel::GLCompute) => vk::ShaderStageFlags::COMPUTE,
            _ => bail!("unknown execution model {model}"),
        };
        let bytes = name.iter().flat_map(|word| word.to_le_bytes());
        let name = CString::new(bytes.take_while(|byte| *byte != 0).collect::<Vec<_>>())?;
        Ok((stage, name))
    }

    fn ty(&self, id: u32) -> Result<(Op, &'a [u32])> {
        self.types.get(&id).copied().context("unknown type")
    }

    fn decoration(&self, id: u32, kind: Decoration) -> Option<u32> {
        self.decorations.get(&(id, kind as u32)).copied()
    }

    /// The type that a variable's pointer leads to.
    fn pointee(&self, pointer: u32) -> Result<u32> {
        match self.ty(pointer)? {
            (Op::TypePointer, [_, ty]) => Ok(*ty),
            _ => bail!("a variable is no pointer"),
        }
    }

    fn bindings(&self) -> Result<Vec<Binding>> {
        let mut bindings = Vec::new();
        for (pointer, id, class) in &self.variables {
            let decorated = |kind| self.decoration(*id, kind);
            if let (Some(set), Some(binding)) = (decorated(Decoration::DescriptorSet), decorated(Decoration::Binding)) {
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
            (Op::TypeArray, [element, length]) => (self.constants.get(length).copied().context("no length")?, *element),
            (Op::TypeRuntimeArray, [element]) => (UNBOUNDED, *element),
            _ => (1, id),
        })
    }

    fn kind(&self, class: StorageClass, id: u32) -> Result<vk::DescriptorType> {
        use vk::DescriptorType as Kind;
        let is_old_buffer = self.decoration(id, Decoration::BufferBlock).is_some();
        Ok(match (class, self.ty(id)?) {
            (StorageClass::StorageBuffer, _) => Kind::STORAGE_BUFFER,
            (StorageClass::Uniform, (Op::TypeStruct, _)) if is_old_buffer => Kind::STORAGE_BUFFER,
            (StorageClass::Uniform, _) => Kind::UNIFORM_BUFFER,
            (StorageClass::UniformConstant, (Op::TypeSampler, _)) => Kind::SAMPLER,
            (StorageClass::UniformConstant, (Op::TypeSampledImage, _)) => Kind::COMBINED_IMAGE_SAMPLER,
            (StorageClass::UniformConstant, (Op::TypeAccelerationStructureKHR, _)) => Kind::ACCELERATION_STRUCTURE_KHR,
            (StorageClass::UniformConstant, (Op::TypeImage, [_, dimension, _, _, _, sampled, ..])) => {
                match (*dimension == Dim::DimBuffer as u32, *sampled == 2) {
                    (false, false) => Kind::SAMPLED_IMAGE,
                    (false, true) => Kind::STORAGE_IMAGE,
                    (true, false) => Kind::UNIFORM_TEXEL_BUFFER,
                    (true, true) => Kind::STORAGE_TEXEL_BUFFER,
                }
            }
            (class, (code, _)) => bail!("unknown resource: storage class {class:?}, type {code:?}"),
        })
    }

    /// Formats by location.
    fn outputs(&self) -> Result<Vec<vk::Format>> {
        let mut outputs = Vec::new();
        for (pointer, id, class) in &self.variables {
            let location = self.decoration(*id, Decoration::Location);
            if let (StorageClass::Output, Some(location)) = (*class, location) {
                outputs.push((location, self.format(self.pointee(*pointer)?)?));
            }
        }
        outputs.sort_by_key(|(location, _)| *location);
        let is_dense = outputs.iter().zip(0..).all(|((location, _), index)| *location == index);
        ensure!(is_dense, "locations of outputs aren't consecutive");
        Ok(outputs.into_iter().map(|(_, format)| format).collect())
    }

    fn format(&self, id: u32) -> Result<vk::Format> {
        Ok(match self.ty(id)? {
            (Op::TypeVector, [element, _]) => self.format(*element)?,
            (Op::TypeFloat, _) => vk::Format::R16G16B16A16_SFLOAT,
            (Op::TypeInt, [_, 0]) => vk::Format::R32G32B32A32_UINT,
            (Op::TypeInt, _) => vk::Format::R32G32B32A32_SINT,
            (code, _) => bail!("an output has type {code:?}"),
        })
    }
}
