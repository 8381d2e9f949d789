//! The acceleration structure of passes with ray queries: instances of some random triangles.

use crate::objects::{Memory, Run};
use crate::values::Values;
use anyhow::Result;
use ash::vk;
use std::slice;

const TRIANGLES: u32 = 48;
const INSTANCES: u32 = 3;
/// Alignment of scratch memory that any device accepts.
const ALIGNMENT: u64 = 256;

/// Records the build of a structure, which the run owns.
pub(crate) fn build(run: &mut Run) -> Result<vk::AccelerationStructureKHR> {
    let mut values = Values::new("triangles");
    let vertices: Vec<u8> = (0..9 * TRIANGLES)
        .flat_map(|_| (2.0 * values.unit() - 1.0).to_le_bytes())
        .collect();
    let vertices = input(run, &vertices)?;
    let triangles = vk::AccelerationStructureGeometryTrianglesDataKHR::default()
        .vertex_format(vk::Format::R32G32B32_SFLOAT)
        .vertex_data(vk::DeviceOrHostAddressConstKHR {
            device_address: vertices,
        })
        .vertex_stride(12)
        .max_vertex(3 * TRIANGLES - 1)
        .index_type(vk::IndexType::NONE_KHR);
    let geometry = vk::AccelerationStructureGeometryKHR::default()
        .geometry_type(vk::GeometryTypeKHR::TRIANGLES)
        .geometry(vk::AccelerationStructureGeometryDataKHR { triangles });
    let mesh = level(run, vk::AccelerationStructureTypeKHR::BOTTOM_LEVEL, geometry, TRIANGLES)?;

    let info = vk::AccelerationStructureDeviceAddressInfoKHR::default().acceleration_structure(mesh);
    // SAFETY: the structure was made by `level`.
    let address = unsafe { run.gpu.structures.get_acceleration_structure_device_address(&info) };
    let instances: Vec<u8> = (0..INSTANCES).flat_map(|index| instance(index, address)).collect();
    let instances = input(run, &instances)?;
    let instances =
        vk::AccelerationStructureGeometryInstancesDataKHR::default().data(vk::DeviceOrHostAddressConstKHR {
            device_address: instances,
        });
    let geometry = vk::AccelerationStructureGeometryKHR::default()
        .geometry_type(vk::GeometryTypeKHR::INSTANCES)
        .geometry(vk::AccelerationStructureGeometryDataKHR { instances });
    level(run, vk::AccelerationStructureTypeKHR::TOP_LEVEL, geometry, INSTANCES)
}

/// `VkAccelerationStructureInstanceKHR`, moved along the x axis.
fn instance(index: u32, mesh: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    let rows = [
        [1.0, 0.0, 0.0, index as f32],
        [0.0, 1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
    ];
    bytes.extend(rows.as_flattened().iter().flat_map(|number: &f32| number.to_le_bytes()));
    // The index with the mask of all rays above, and no flags.
    bytes.extend((index | 0xff00_0000).to_le_bytes());
    bytes.extend(0u32.to_le_bytes());
    bytes.extend(mesh.to_le_bytes());
    bytes
}

/// The address of a buffer with these contents.
fn input(run: &mut Run, contents: &[u8]) -> Result<u64> {
    let usage = vk::BufferUsageFlags::ACCELERATION_STRUCTURE_BUILD_INPUT_READ_ONLY_KHR;
    let made = run.buffer(contents, usage | vk::BufferUsageFlags::SHADER_DEVICE_ADDRESS)?;
    Ok(address(run, made))
}

fn address(run: &Run, memory: Memory) -> u64 {
    let info = vk::BufferDeviceAddressInfo::default().buffer(memory.buffer);
    // SAFETY: the buffer was made with the usage for addresses.
    unsafe { run.device().get_buffer_device_address(&info) }
}

/// Records the build of a level.
fn level(
    run: &mut Run,
    kind: vk::AccelerationStructureTypeKHR,
    geometry: vk::AccelerationStructureGeometryKHR,
    count: u32,
) -> Result<vk::AccelerationStructureKHR> {
    let info = vk::AccelerationStructureBuildGeometryInfoKHR::default()
        .ty(kind)
        .mode(vk::BuildAccelerationStructureModeKHR::BUILD)
        .geometries(slice::from_ref(&geometry));
    let mut sizes = vk::AccelerationStructureBuildSizesInfoKHR::default();
    // SAFETY: the geometry is complete.
    unsafe {
        run.gpu.structures.get_acceleration_structure_build_sizes(
            vk::AccelerationStructureBuildTypeKHR::DEVICE,
            &info,
            &[count],
            &mut sizes,
        );
    }
    let storage = vec![0; sizes.acceleration_structure_size as usize];
    let storage = run.buffer(&storage, vk::BufferUsageFlags::ACCELERATION_STRUCTURE_STORAGE_KHR)?;
    let scratch = vec![0; (sizes.build_scratch_size + ALIGNMENT) as usize];
    let usage = vk::BufferUsageFlags::STORAGE_BUFFER | vk::BufferUsageFlags::SHADER_DEVICE_ADDRESS;
    let scratch = run.buffer(&scratch, usage)?;
    let scratch = address(run, scratch).next_multiple_of(ALIGNMENT);
    let made = vk::AccelerationStructureCreateInfoKHR::default()
        .ty(kind)
        .buffer(storage.buffer)
        .size(sizes.acceleration_structure_size);
    // SAFETY: the buffers have the sizes that the device asked for, and live as long as the run.
    let structure = unsafe {
        let structure = run.gpu.structures.create_acceleration_structure(&made, None)?;
        run.structures.push(structure);
        let info = info
            .dst_acceleration_structure(structure)
            .scratch_data(vk::DeviceOrHostAddressKHR {
                device_address: scratch,
            });
        let range = vk::AccelerationStructureBuildRangeInfoKHR::default().primitive_count(count);
        run.gpu
            .structures
            .cmd_build_acceleration_structures(run.commands, &[info], &[slice::from_ref(&range)]);
        structure
    };
    run.barrier(&[]);
    Ok(structure)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instances_have_vulkans_layout() {
        let bytes = instance(2, 0x0102_0304_0506_0708);
        assert_eq!(bytes.len(), 64);
        assert_eq!(bytes[12..16], 2.0f32.to_le_bytes());
        assert_eq!(bytes[48..52], [2, 0, 0, 0xff]);
        assert_eq!(bytes[56], 8);
    }
}
