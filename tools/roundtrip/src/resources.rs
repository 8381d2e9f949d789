//! The resources of a pass, as its WGSL declares them, with their contents.

use crate::values::{self, EDGE, Values};
use anyhow::{Context, Result, anyhow, bail};
use ash::vk;
use half::f16;
use naga::{
    AddressSpace, GlobalVariable, Handle, ImageClass, ImageDimension, Module, ScalarKind, ShaderStage, StorageAccess,
    StorageFormat, Type, TypeInner,
};

/// Layers of an array of textures, and texels of a volume in each direction.
const LAYERS: u32 = 4;
const SIDE: u32 = 16;

/// A compute pass.
pub struct Pass {
    /// Invocations of a workgroup.
    pub workgroup: [u32; 3],
    pub resources: Vec<Resource>,
}

/// A resource and its contents before the pass.
pub struct Resource {
    pub name: String,
    pub set: u32,
    pub binding: u32,
    pub kind: Kind,
    /// The pass can write to it.
    pub is_output: bool,
    pub contents: Vec<u8>,
}

/// Kinds of resources.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Uniform,
    Storage,
    Sampler {
        compares: bool,
    },
    Image(Image),
    /// The same objects in each.
    Structure,
}

/// An image and its view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Image {
    pub format: vk::Format,
    /// Number and kind of a texel's components.
    pub texel: (usize, Component),
    pub view: vk::ImageViewType,
    pub extent: [u32; 3],
    pub layers: u32,
    pub usage: vk::ImageUsageFlags,
}

impl Kind {
    pub fn descriptor(self) -> vk::DescriptorType {
        match self {
            Self::Uniform => vk::DescriptorType::UNIFORM_BUFFER,
            Self::Storage => vk::DescriptorType::STORAGE_BUFFER,
            Self::Sampler { .. } => vk::DescriptorType::SAMPLER,
            Self::Structure => vk::DescriptorType::ACCELERATION_STRUCTURE_KHR,
            Self::Image(image) if image.usage == vk::ImageUsageFlags::STORAGE => vk::DescriptorType::STORAGE_IMAGE,
            Self::Image(_) => vk::DescriptorType::SAMPLED_IMAGE,
        }
    }
}

impl Pass {
    /// Reads the resources of WGSL. The contents depend on their names and the seed alone.
    pub fn read(source: &str, entry: &str, seed: u32) -> Result<Self> {
        let module = naga::front::wgsl::parse_str(source).map_err(|error| anyhow!(error.emit_to_string(source)))?;
        let point = module.entry_points.iter().find(|point| point.name == entry);
        let point = point.with_context(|| format!("no entry point {entry}"))?;
        if point.stage != ShaderStage::Compute {
            bail!("only compute passes run");
        }
        let resources = module
            .global_variables
            .iter()
            .filter(|(_, variable)| variable.binding.is_some());
        let resources = resources.map(|(_, variable)| Resource::new(&module, variable, seed));
        Ok(Self {
            workgroup: point.workgroup_size,
            resources: resources.collect::<Result<_>>()?,
        })
    }

    /// Workgroups that cover the view: tiles, blocks of pixels, or entries of a list.
    pub fn workgroups(&self) -> [u32; 3] {
        let [x, y, _] = self.workgroup;
        let is_list = |resource: &Resource| resource.name.ends_with("list") && !resource.is_output;
        if self.resources.iter().any(is_list) {
            [EDGE, 1, 1]
        } else if y > 1 {
            [EDGE.div_ceil(x), EDGE.div_ceil(y), 1]
        } else {
            [EDGE / 16, EDGE / 16, 1]
        }
    }
}

impl Resource {
    fn new(module: &Module, variable: &GlobalVariable, seed: u32) -> Result<Self> {
        let binding = variable.binding.context("no binding")?;
        let name = plain_name(variable.name.as_deref().unwrap_or_default()).to_owned();
        let mut values = Values::new(&format!("{name} {seed}"));
        let is_structure = |ty: &Type| matches!(ty.inner, TypeInner::AccelerationStructure { .. });
        values.has_objects = module.types.iter().any(|(_, ty)| is_structure(ty));
        let (kind, is_output, contents) = match (&module.types[variable.ty].inner, variable.space) {
            (TypeInner::Sampler { comparison }, _) => (Kind::Sampler { compares: *comparison }, false, Vec::new()),
            (TypeInner::Image { dim, arrayed, class }, _) => {
                let (image, is_output) = image(*dim, *arrayed, *class)?;
                (Kind::Image(image), is_output, texels(&mut values, &name, &image))
            }
            (TypeInner::AccelerationStructure { .. }, _) => (Kind::Structure, false, Vec::new()),
            (_, AddressSpace::Uniform) => (Kind::Uniform, false, buffer(&mut values, module, variable.ty, &name)?),
            (_, AddressSpace::Storage { access }) => {
                let contents = buffer(&mut values, module, variable.ty, &name)?;
                (Kind::Storage, access.contains(StorageAccess::STORE), contents)
            }
            (other, _) => bail!("{name} is {other:?}"),
        };
        Ok(Self {
            name,
            set: binding.group,
            binding: binding.binding,
            kind,
            is_output,
            contents,
        })
    }
}

/// A variable's own name, from the linker's name with the path of its module: `_1bevy_glint_denoise_tiles__1tile_list` is `tile_list`.
/// Parts are separated by underscores, and parts with underscores begin with their number.
fn plain_name(linked: &str) -> &str {
    let mut rest = linked;
    if counted(rest).is_none_or(|(count, _)| count == 0) {
        return linked;
    }
    loop {
        let (count, part) = counted(rest).unwrap_or((0, rest));
        match part.match_indices('_').nth(count) {
            Some((end, _)) => rest = &part[end + 1..],
            None => return part,
        }
    }
}

/// The number of underscores in the first part, and what follows the number.
fn counted(name: &str) -> Option<(usize, &str)> {
    let digits = name.strip_prefix('_')?;
    let end = digits.find(|digit: char| !digit.is_ascii_digit())?;
    Some((digits[..end].parse().ok()?, &digits[end..]))
}

fn buffer(values: &mut Values, module: &Module, ty: Handle<Type>, name: &str) -> Result<Vec<u8>> {
    let mut contents = vec![0; values::size(module, ty) as usize];
    values.fill(module, ty, name, &mut contents)?;
    Ok(contents)
}

/// The image, and whether a pass can write to it.
fn image(dim: ImageDimension, arrayed: bool, class: ImageClass) -> Result<(Image, bool)> {
    let (view, extent, layers) = match (dim, arrayed) {
        (ImageDimension::D2, false) => (vk::ImageViewType::TYPE_2D, [EDGE, EDGE, 1], 1),
        (ImageDimension::D2, true) => (vk::ImageViewType::TYPE_2D_ARRAY, [EDGE, EDGE, 1], LAYERS),
        (ImageDimension::D3, false) => (vk::ImageViewType::TYPE_3D, [SIDE, SIDE, SIDE], 1),
        (ImageDimension::Cube, false) => (vk::ImageViewType::CUBE, [SIDE, SIDE, 1], 6),
        other => bail!("unknown kind of image: {other:?}"),
    };
    let (format, texel) = match class {
        ImageClass::Depth { multi: false } => (vk::Format::D32_SFLOAT, (1, Component::Float)),
        ImageClass::Sampled { kind, multi: false } => format(match kind {
            ScalarKind::Float => StorageFormat::Rgba32Float,
            ScalarKind::Uint => StorageFormat::Rgba32Uint,
            ScalarKind::Sint => StorageFormat::Rgba32Sint,
            other => bail!("no texture has {other:?}"),
        })?,
        ImageClass::Storage { format: stored, .. } => format(stored)?,
        other => bail!("unknown class of image: {other:?}"),
    };
    let (usage, is_output) = match class {
        ImageClass::Storage { access, .. } => (vk::ImageUsageFlags::STORAGE, access.contains(StorageAccess::STORE)),
        _ => (vk::ImageUsageFlags::SAMPLED, false),
    };
    let image = Image {
        format,
        texel,
        view,
        extent,
        layers,
        usage,
    };
    Ok((image, is_output))
}

/// Vulkan's format, and the number and kind of its components.
fn format(format: StorageFormat) -> Result<(vk::Format, (usize, Component))> {
    Ok(match format {
        StorageFormat::R32Uint => (vk::Format::R32_UINT, (1, Component::Integer)),
        StorageFormat::R32Float => (vk::Format::R32_SFLOAT, (1, Component::Float)),
        StorageFormat::Rg32Uint => (vk::Format::R32G32_UINT, (2, Component::Integer)),
        StorageFormat::Rg32Float => (vk::Format::R32G32_SFLOAT, (2, Component::Float)),
        StorageFormat::Rgba16Float => (vk::Format::R16G16B16A16_SFLOAT, (4, Component::Half)),
        StorageFormat::Rgba32Uint => (vk::Format::R32G32B32A32_UINT, (4, Component::Integer)),
        StorageFormat::Rgba32Sint => (vk::Format::R32G32B32A32_SINT, (4, Component::Integer)),
        StorageFormat::Rgba32Float => (vk::Format::R32G32B32A32_SFLOAT, (4, Component::Float)),
        other => bail!("unknown format {other:?}"),
    })
}

/// A component of a texel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Component {
    Integer,
    Float,
    Half,
}

fn texels(values: &mut Values, name: &str, image: &Image) -> Vec<u8> {
    let (count, component) = image.texel;
    let texels = image.extent.iter().product::<u32>() as usize * image.layers as usize;
    let mut contents = Vec::new();
    for _ in 0..texels * count {
        let word = values.texel(name, component != Component::Integer);
        if component == Component::Half {
            contents.extend(f16::from_f32(f32::from_bits(word)).to_le_bytes());
        } else {
            contents.extend(word.to_le_bytes());
        }
    }
    contents
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOURCE: &str = "
        struct View { size: vec2<u32>, scale: f32 }
        @group(0) @binding(0) var<uniform> view: View;
        @group(0) @binding(3) var<storage, read> list: array<u32>;
        @group(1) @binding(1) var sky: texture_cube<f32>;
        @group(1) @binding(2) var sky_sampler: sampler;
        @group(0) @binding(4) var out: texture_storage_2d<rgba16float, write>;
        @compute @workgroup_size(8, 8) fn main(@builtin(global_invocation_id) id: vec3<u32>) {
            textureStore(out, id.xy, textureSampleLevel(sky, sky_sampler, vec3(f32(list[id.x])), view.scale));
        }";

    #[test]
    fn resources_are_those_of_the_source() {
        let pass = Pass::read(SOURCE, "main", 0).unwrap();
        assert_eq!(pass.workgroups(), [64, 1, 1]);
        let of_pixels = Pass::read(&SOURCE.replace("list", "words"), "main", 0).unwrap();
        assert_eq!(of_pixels.workgroups(), [8, 8, 1]);
        let found: Vec<_> = pass
            .resources
            .iter()
            .map(|resource| {
                (
                    resource.name.as_str(),
                    resource.set,
                    resource.binding,
                    resource.kind.descriptor(),
                    resource.contents.len(),
                )
            })
            .collect();
        let expected = [
            ("view", 0, 0, vk::DescriptorType::UNIFORM_BUFFER, 16),
            ("list", 0, 3, vk::DescriptorType::STORAGE_BUFFER, 4 * 4096),
            ("sky", 1, 1, vk::DescriptorType::SAMPLED_IMAGE, 6 * 16 * 16 * 16),
            ("sky_sampler", 1, 2, vk::DescriptorType::SAMPLER, 0),
            ("out", 0, 4, vk::DescriptorType::STORAGE_IMAGE, 64 * 64 * 8),
        ];
        assert_eq!(found, expected);
        let outputs: Vec<_> = pass.resources.iter().filter(|resource| resource.is_output).collect();
        assert_eq!(outputs.len(), 1);
        assert!(Pass::read(SOURCE, "other", 0).is_err());
    }

    #[test]
    fn names_lose_their_paths() {
        for (linked, plain) in [
            ("_1bevy_glint_denoise_tiles__1tile_list", "tile_list"),
            ("_1bevy_glint_scene_bindings_bvh", "bvh"),
            ("_1bevy_glint_rate_tile__2ray_list_out", "ray_list_out"),
            ("indirect_args", "indirect_args"),
            ("_unused", "_unused"),
        ] {
            assert_eq!(plain_name(linked), plain);
        }
    }
}
