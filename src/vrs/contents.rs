//! Contents of a bind group, which wgpu doesn't expose.

use super::device::{acceleration_structure_address, raw_buffer, raw_view};
use ash::vk;
use bevy::render::{
    render_resource::{
        AddressMode, BindGroup, BindGroupEntry, BindingResource, CompareFunction, FilterMode, MipmapFilterMode,
        SamplerDescriptor, WgpuSampler, WgpuTextureView,
    },
    renderer::RenderDevice,
};

/// A bind group with the Vulkan handles of all its resources, which live as long as it does.
pub(super) struct GroupContents {
    pub(super) bind_group: BindGroup,
    pub(super) bindings: Vec<(u32, Content)>,
    /// Descriptors of samplers, because wgpu doesn't expose its samplers.
    pub(super) samplers: Vec<vk::SamplerCreateInfo<'static>>,
    /// Address of the first acceleration structure, if the group has one: all objects are in it while a view uses this pass.
    pub(super) acceleration_structure: Option<u64>,
}

pub(super) enum Content {
    Buffer(vk::DescriptorBufferInfo),
    Views(Vec<View>),
    /// Indices in [`GroupContents::samplers`].
    Samplers(Vec<usize>),
}

pub(super) struct View {
    pub raw: vk::ImageView,
    pub is_depth: bool,
}

/// The contents of a bind group that outlives the frame, kept beside it while a view uses variable rate shading. Empty until it is
/// [filled](Self::fill).
#[derive(Default)]
pub(crate) struct BindGroupContents(Option<Result<GroupContents, String>>);

impl BindGroupContents {
    pub(crate) fn is_missing(&self) -> bool {
        self.0.is_none()
    }

    /// Call whenever the bind group is created again or its contents are no longer used.
    pub(crate) fn clear(&mut self) {
        self.0 = None;
    }

    /// `entries` are the entries of the bind group; `samplers` contains all samplers among them with their descriptors.
    pub(crate) fn fill(
        &mut self,
        device: &RenderDevice,
        bind_group: &BindGroup,
        entries: &[BindGroupEntry],
        samplers: &[(&WgpuSampler, SamplerDescriptor)],
    ) {
        self.0 = Some(GroupContents::new(device, bind_group, entries, samplers));
    }

    pub(super) fn contents(&self) -> Result<&GroupContents, String> {
        match &self.0 {
            Some(Ok(contents)) => Ok(contents),
            Some(Err(reason)) => Err(reason.clone()),
            None => Err("the contents of a bind group aren't known".into()),
        }
    }
}

impl GroupContents {
    /// `entries` are the ones from which the bind group was created; `samplers` contains all samplers among them with their descriptors.
    ///
    /// # Errors
    /// The reason why the group can't be bound, as the end of a sentence: the renderer doesn't use Vulkan, something was
    /// destroyed, or the descriptor of a sampler is missing.
    fn new(
        device: &RenderDevice,
        bind_group: &BindGroup,
        entries: &[BindGroupEntry],
        samplers: &[(&WgpuSampler, SamplerDescriptor)],
    ) -> Result<Self, String> {
        let mut contents = Self {
            bind_group: bind_group.clone(),
            bindings: Vec::with_capacity(entries.len()),
            samplers: samplers
                .iter()
                .map(|(_, descriptor)| sampler_info(descriptor))
                .collect(),
            acceleration_structure: None,
        };
        let sampler = |wanted: &WgpuSampler| {
            let index = samplers.iter().position(|(sampler, _)| *sampler == wanted);
            index.ok_or("the descriptor of a sampler isn't known")
        };
        for BindGroupEntry { binding, resource } in entries {
            let content = match resource {
                BindingResource::Buffer(range) => {
                    let size = range.size.map_or(range.buffer.size() - range.offset, Into::into);
                    Content::Buffer(
                        vk::DescriptorBufferInfo::default()
                            .buffer(raw_buffer(range.buffer)?)
                            .offset(range.offset)
                            .range(size),
                    )
                }
                BindingResource::TextureView(texture) => Content::Views(vec![view(texture)?]),
                BindingResource::TextureViewArray(list) => {
                    let list = list.iter().map(|texture| view(texture));
                    Content::Views(list.collect::<Result<_, String>>()?)
                }
                BindingResource::Sampler(single) => Content::Samplers(vec![sampler(single)?]),
                BindingResource::SamplerArray(list) => {
                    let list = list.iter().map(|single| sampler(single));
                    Content::Samplers(list.collect::<Result<_, &str>>()?)
                }
                BindingResource::AccelerationStructure(tlas) => {
                    if contents.acceleration_structure.is_none() {
                        contents.acceleration_structure = Some(acceleration_structure_address(device, tlas)?);
                    }
                    continue;
                }
                _ => return Err(format!("binding {binding} is of a kind that can't be bound")),
            };
            contents.bindings.push((*binding, content));
        }
        Ok(contents)
    }
}

fn view(view: &WgpuTextureView) -> Result<View, String> {
    Ok(View {
        raw: raw_view(view)?,
        is_depth: view.texture().format().is_depth_stencil_format(),
    })
}

/// The same as in wgpu on a device with anisotropic filtering.
pub(super) fn sampler_info(descriptor: &SamplerDescriptor) -> vk::SamplerCreateInfo<'static> {
    let filter = |mode| match mode {
        FilterMode::Nearest => vk::Filter::NEAREST,
        FilterMode::Linear => vk::Filter::LINEAR,
    };
    let address = |mode| match mode {
        AddressMode::ClampToEdge => vk::SamplerAddressMode::CLAMP_TO_EDGE,
        AddressMode::Repeat => vk::SamplerAddressMode::REPEAT,
        AddressMode::MirrorRepeat => vk::SamplerAddressMode::MIRRORED_REPEAT,
        AddressMode::ClampToBorder => vk::SamplerAddressMode::CLAMP_TO_BORDER,
    };
    let mut info = vk::SamplerCreateInfo::default()
        .mag_filter(filter(descriptor.mag_filter))
        .min_filter(filter(descriptor.min_filter))
        .mipmap_mode(match descriptor.mipmap_filter {
            MipmapFilterMode::Nearest => vk::SamplerMipmapMode::NEAREST,
            MipmapFilterMode::Linear => vk::SamplerMipmapMode::LINEAR,
        })
        .address_mode_u(address(descriptor.address_mode_u))
        .address_mode_v(address(descriptor.address_mode_v))
        .address_mode_w(address(descriptor.address_mode_w))
        .min_lod(descriptor.lod_min_clamp)
        .max_lod(descriptor.lod_max_clamp);
    if let Some(function) = descriptor.compare {
        info = info.compare_enable(true).compare_op(match function {
            CompareFunction::Never => vk::CompareOp::NEVER,
            CompareFunction::Less => vk::CompareOp::LESS,
            CompareFunction::LessEqual => vk::CompareOp::LESS_OR_EQUAL,
            CompareFunction::Equal => vk::CompareOp::EQUAL,
            CompareFunction::GreaterEqual => vk::CompareOp::GREATER_OR_EQUAL,
            CompareFunction::Greater => vk::CompareOp::GREATER,
            CompareFunction::NotEqual => vk::CompareOp::NOT_EQUAL,
            CompareFunction::Always => vk::CompareOp::ALWAYS,
        });
    }
    if descriptor.anisotropy_clamp > 1 {
        let most = descriptor.anisotropy_clamp.min(16);
        info = info.anisotropy_enable(true).max_anisotropy(f32::from(most));
    }
    if let Some(color) = descriptor.border_color {
        info = info.border_color(match color {
            wgpu::SamplerBorderColor::TransparentBlack | wgpu::SamplerBorderColor::Zero => {
                vk::BorderColor::FLOAT_TRANSPARENT_BLACK
            }
            wgpu::SamplerBorderColor::OpaqueBlack => vk::BorderColor::FLOAT_OPAQUE_BLACK,
            wgpu::SamplerBorderColor::OpaqueWhite => vk::BorderColor::FLOAT_OPAQUE_WHITE,
        });
    }
    info
}
