//! The structs of `types.wesl` on the CPU.

use bytemuck::{Pod, Zeroable};

/// A texture slot that is not used.
pub const NO_TEXTURE: u32 = u32::MAX;

/// The object-to-world matrix has a negative determinant.
pub const INSTANCE_MIRRORED: u32 = 1;
/// Closest-hit rays pass through triangles that face away from them, and shadow rays through those that face away from the light.
pub const INSTANCE_CULL_BACK: u32 = 2;
/// Closest-hit rays pass through triangles that face them, and shadow rays through those that face the light.
pub const INSTANCE_CULL_FRONT: u32 = 4;
/// Candidates need the alpha test of their material.
pub const INSTANCE_ALPHA_MASKED: u32 = 8;
/// The instance blocks shadow rays.
pub const INSTANCE_CASTS_SHADOW: u32 = 16;
/// The instance receives shadows.
pub const INSTANCE_RECEIVES_SHADOW: u32 = 32;
/// The instance has moved since the last frame.
pub const INSTANCE_MOVING: u32 = 64;
/// The instance has moved lately.
pub const INSTANCE_RESTLESS: u32 = 128;
/// The light that passes through the instance receives shadows.
pub const INSTANCE_RECEIVES_TRANSMITTED_SHADOW: u32 = 256;
/// Ray queries: the static TLAS still contains the former object of this slot, which has moved or is gone.
pub const INSTANCE_LEFT: u32 = 512;
/// The instance is drawn with a different material than its hits have.
pub const INSTANCE_STAND_IN: u32 = 1024;
/// From this bit on, three bits contain the phase in which Bevy draws the instance, counted from 0.
pub const INSTANCE_DRAWN_SHIFT: u32 = 11;
/// Bits of the depth bias, in 64 units, as a half float without its lowest bits; shifted by [`INSTANCE_DRAWN_SHIFT`].
pub const INSTANCE_DEPTH_BIAS: u32 = 0xfff8;

/// The material is not lit.
pub const MATERIAL_UNLIT: u32 = 1;
/// Back faces are shaded with a flipped normal.
pub const MATERIAL_DOUBLE_SIDED: u32 = 2;
/// The normal map's green channel points down.
pub const MATERIAL_FLIP_NORMAL_MAP_Y: u32 = 4;
/// The normal map has two channels; the third follows from unit length.
pub const MATERIAL_TWO_COMPONENT_NORMAL_MAP: u32 = 8;
/// The metallic-roughness texture has two channels: roughness in red, metallic in green.
pub const MATERIAL_METALLIC_ROUGHNESS_RG: u32 = 16;
/// From this bit on, there is one bit per texture slot, set if the texture uses the second UV set.
pub const MATERIAL_UV1_SHIFT: u32 = 16;
/// Alpha of the base-colour texture is ignored.
pub const MATERIAL_SOLID_TEXTURE: u32 = 32;
/// The material has changed lately.
pub const MATERIAL_RESTLESS: u32 = 64;
/// The surface shows distance fog.
pub const MATERIAL_FOG: u32 = 128;

/// The surface is drawn over the opaque image.
pub const MATERIAL_SEE_THROUGH: u32 = 256;
/// Alpha scales the surface's reflected light.
pub const MATERIAL_FADES: u32 = 512;
/// Bevy lights the surface in its forward pass, which keeps base colours above 1.
pub const MATERIAL_LIT_FORWARD: u32 = 16384;
/// Opaque, lit and drawn in Bevy's forward pass: it has no pixel in Bevy's G-buffer.
pub const MATERIAL_FORWARD: u32 = 32768;
/// From this bit on, bits contain the number of the material's type: 0 is `StandardMaterial`.
pub const MATERIAL_TYPE_SHIFT: u32 = 10;
/// Mask of these bits, shifted to 0.
pub const MATERIAL_TYPE_BITS: u32 = 15;
/// Bevy adds all of the surface's reflected light, regardless of alpha.
pub const MATERIAL_PREMULTIPLIED: u32 = 2_097_152;
/// Bevy draws the surface in its forward pass, where it shows clustered decals. Its G-buffer has none.
pub const MATERIAL_DECALS: u32 = 4_194_304;

/// Optical depth beyond which nothing is visible: 1e-7 of the light is left. A higher value makes the steps of
/// [`GpuMaterial::optical_depth`] coarser.
pub const OPAQUE_DEPTH: f32 = 16.0;

/// [`GpuMaterial::stop_probability`] of materials with alpha to coverage. Closest-hit rays test them by their own cutoff, shadow rays by
/// 0.05.
pub const COVERAGE: f32 = -2.0;

/// Slot of [`GpuMaterial::textures`].
pub const TEXTURE_BASE_COLOR: usize = 0;
/// Slot of [`GpuMaterial::textures`].
pub const TEXTURE_EMISSIVE: usize = 1;
/// Slot of [`GpuMaterial::textures`].
pub const TEXTURE_METALLIC_ROUGHNESS: usize = 2;
/// Slot of [`GpuMaterial::textures`].
pub const TEXTURE_NORMAL: usize = 3;
/// Slot of [`GpuMaterial::textures`].
pub const TEXTURE_OCCLUSION: usize = 4;

/// Kind of [`GpuLight`].
pub const LIGHT_DIRECTIONAL: u32 = 0;
/// Kind of [`GpuLight`].
pub const LIGHT_POINT: u32 = 1;
/// Kind of [`GpuLight`].
pub const LIGHT_SPOT: u32 = 2;
/// Kind of [`GpuLight`].
pub const LIGHT_RECT: u32 = 3;
/// Flag of [`GpuLight`].
pub const LIGHT_CASTS_SHADOW: u32 = 1;
/// Flag of [`GpuLight`]: it has changed lately.
pub const LIGHT_RESTLESS: u32 = 2;
/// Flag of [`GpuLight`]: the light is visible in fog volumes.
pub const LIGHT_VOLUMETRIC: u32 = 4;
/// From this bit on, bits of [`GpuLight::flags`] contain the number of the light's texture, counted from 1; 0 is none.
pub const LIGHT_TEXTURE_SHIFT: u32 = 8;

/// One object that rays can hit. Matrices are rows of 3x4.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuInstance {
    /// Rows of the 3x4 matrix.
    pub world_from_object: [[f32; 4]; 3],
    /// Rows of the 3x4 matrix.
    pub object_from_world: [[f32; 4]; 3],
    /// Word of the mesh's header in the geometry buffer.
    pub geometry_base: u32,
    /// Index in the material buffer.
    pub material: u32,
    /// `INSTANCE_` flags.
    pub flags: u32,
    /// Low bits of the entity, for debug views.
    pub id: u32,
    /// BVH tracer: offset of the masks of an alpha-masked instance in the tree buffer.
    pub masks: u32,
    /// Lightmap: a word as in [`GpuMaterial::textures`].
    pub lightmap: u32,
    /// Corners of the object's rectangle in the lightmap, 16 bits each: u, then v in the upper half. Without a lightmap, the object's
    /// motion while [`INSTANCE_MOVING`] is set, and whether its vertices have one: `motion.rs`.
    pub lightmap_rect_or_motion: [u32; 2],
}

/// The part of a `StandardMaterial` that shading of hits needs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuMaterial {
    /// Linear.
    pub base_color: [f32; 4],
    /// Linear; the last component is the fraction of diffuse light that is transmitted.
    pub emissive: [f32; 4],
    /// Texture index in the low 20 bits, sampler index in the high 12 bits, or [`NO_TEXTURE`].
    pub textures: [u32; 5],
    /// `MATERIAL_` flags.
    pub flags: u32,
    /// 0 to 1.
    pub metallic: f32,
    /// 0 to 1.
    pub perceptual_roughness: f32,
    /// Columns of the 2x2 part.
    pub uv_transform: [f32; 4],
    /// Translation of the UV transform.
    pub uv_offset: [f32; 2],
    /// Luminance of reflectance times specular tint.
    pub reflectance: f32,
    /// Rays pass below this alpha. For blended and transmissive materials, this applies only to shadow rays.
    pub alpha_cutoff: f32,
    /// Probability that a ray stops at an alpha of 1. Negative for materials without stochastic transparency; [`COVERAGE`] for materials
    /// with alpha to coverage.
    pub stop_probability: f32,
    /// Fraction of the stopped light that is reflected diffusely.
    pub diffuse_share: f32,
    /// Factor of light from lightmaps.
    pub lightmap_exposure: f32,
    /// Clearcoat as in the G-buffer: strength in fifteenths in the low 4 bits, perceptual roughness in thirtieths in the next 4. The upper
    /// 24 bits contain the hue of the specular tint, which Bevy shows in its forward pass. Red, green and blue are scaled until the largest
    /// is 255, and stored as their differences to 255, so that 0 is white.
    pub clearcoat: u32,
    /// Metres between the points where light enters and leaves, for refraction and diffuse transmission; otherwise 0.
    pub thickness: f32,
    /// Index of refraction of glass with a thickness, above 1; otherwise 0.
    pub ior: f32,
    /// Optical depth of the volume for red, green and blue, in fractions of [`OPAQUE_DEPTH`], 16 bits each. The last 16 bits are the
    /// weight with which exposure scales emission.
    pub optical_depth: [u32; 2],
}

/// A light that shines on hits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuLight {
    /// Linear; lux, candela or nits by kind.
    pub color: [f32; 3],
    /// `LIGHT_` kind.
    pub kind: u32,
    /// World space.
    pub position: [f32; 3],
    /// 1 / range^2.
    pub inverse_range_squared: f32,
    /// Direction to a directional light, or the direction in which a spot or rectangle shines.
    pub direction: [f32; 3],
    /// Spherical lights: radius in metres. Rectangles: angle of the width axis about `direction` in radians. Directional lights: the angle
    /// of their disk.
    pub radius: f32,
    /// Spot: scale and offset of the cone's falloff. Rectangles: half width and half height.
    pub spot: [f32; 2],
    /// [`LIGHT_CASTS_SHADOW`], [`LIGHT_RESTLESS`], [`LIGHT_VOLUMETRIC`], and the number of a texture.
    pub flags: u32,
    /// Point and spot lights: surfaces nearer to the light than this cast no shadow, in metres.
    pub shadow_near: f32,
}

/// The texture of a light. It occupies the space of a light in the buffer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuLightTexture {
    /// Rows of the 3x4 matrix into the light's own space.
    pub light_from_world: [[f32; 4]; 3],
    /// Point lights: the layout of a cube map. Spots: tangent of the cone's half angle. Directional lights: 1 if the texture repeats.
    pub projection: f32,
    /// Padding to the layout of a light.
    pub unused: f32,
    /// A word as in [`GpuMaterial::textures`].
    pub texture: u32,
    /// Padding to the size of a light.
    pub padding: f32,
}

/// A reflection probe or an irradiance volume.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuLightProbe {
    /// Rows of the 3x4 matrix into a space in which the probe's box of influence extends from -0.5 to 0.5.
    pub probe_from_world: [[f32; 4]; 3],
    /// Fraction of the box on each axis over which the influence falls off.
    pub falloff: [f32; 3],
    /// Factor from texels to cd/m^2.
    pub intensity: f32,
    /// Half extents of the box onto which its maps are projected, in the space of the probe.
    pub parallax_bounds: [f32; 3],
    /// 0 if its maps are infinitely far away.
    pub has_parallax: u32,
}

/// Counts of the scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuSceneCounts {
    /// Number of lights in the buffer. The nodes of their tree follow.
    pub light_count: u32,
    /// Number of nodes; 0 if nothing can be hit. BVH tracer: `Tlas::traversal_node_count`.
    pub tlas_node_count: u32,
    /// BVH tracer: index of the TLAS's root.
    pub tlas_root: u32,
    /// Ray queries: number of objects in the moving TLAS.
    pub moving_count: u32,
    /// Instances in the buffer.
    pub instance_count: u32,
    /// Materials in the buffer.
    pub material_count: u32,
    /// Textures in the array.
    pub texture_count: u32,
    /// Reflection probes, at the beginning of the buffer of light probes.
    pub reflection_probe_count: u32,
    /// Irradiance volumes, which follow them.
    pub irradiance_volume_count: u32,
    /// Directional lights at the beginning of the buffer of lights, if hits sample the others.
    pub directional_light_count: u32,
    /// Nodes of the last level of the tree over the other lights; 0 = none.
    pub light_leaf_count: u32,
    /// Ray queries: number of slots with `INSTANCE_LEFT`, including slots beyond the last instance.
    pub left_count: u32,
    /// A bit for each light probe in the buffer that has changed lately.
    pub restless_probes: u32,
    /// Textures of lights.
    pub light_texture_count: u32,
    /// Index of the first texture in the buffer of lights.
    pub first_light_texture: u32,
    /// The largest depth bias of all materials, at least 0.
    pub largest_depth_bias: f32,
    /// Difference between the largest and the smallest one.
    pub depth_bias_range: f32,
    /// Word of the geometry buffer at which the table of particles begins.
    pub first_particle_word: u32,
    /// Leaves of its tree, a power of two; 0 without particles.
    pub particle_leaf_count: u32,
    /// Number of particles.
    pub particle_count: u32,
    /// 1 if particles changed in this frame.
    pub particles_move: u32,
    /// Word of the geometry buffer at which the table of decals begins.
    pub first_decal_word: u32,
    /// Leaves of its tree, a power of two; 0 without decals.
    pub decal_leaf_count: u32,
    /// Number of decals.
    pub decal_count: u32,
}

const _: () = assert!(size_of::<GpuInstance>() == 128);
const _: () = assert!(size_of::<GpuMaterial>() == 128);
const _: () = assert!(size_of::<GpuLight>() == 64);
const _: () = assert!(size_of::<GpuLightTexture>() == size_of::<GpuLight>());
const _: () = assert!(size_of::<GpuLightProbe>() == 80);
const _: () = assert!(size_of::<GpuSceneCounts>() == 96);
