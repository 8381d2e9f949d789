//! The app's shader that moves vertices.

use crate::{
    app_module::{AppModule, Place},
    scene::acceleration::rows,
    settings::{ReflectedVertexShader, ReflectedVertices},
};
use bevy::{
    asset::{AssetEvent, Assets},
    ecs::prelude::*,
    math::{Affine3A, Vec3, Vec4},
    render::{Extract, render_resource::PipelineCache},
    shader::Shader,
    time::Time,
};

/// The module that `pose.wesl` imports.
const PLACE: Place = Place {
    folder: "app_vertex",
    path: "embedded://bevy_glint/scene/pose/app_vertex.wesl",
    source: "
        import {app}::reflected_vertex as app_vertex;
        import package::scene::pose::vertex::{VertexPoint, WorldVertex};

        fn reflected_vertex(vertex: WorldVertex, at: VertexPoint) -> WorldVertex {
            return app_vertex(vertex, at);
        }
    ",
    id: 0x2f80_71c4_9be5_4d36_a7d2_60e3_b418_0000,
    resource: "ReflectedVertexShader",
};

/// The app's shader, as known to the renderer. A GPU resource: it is sent again to the pipeline cache of a new device.
#[derive(Resource, Default)]
pub struct VertexShader {
    module: AppModule,
    /// The app has the resource, perhaps before its shader is loaded.
    is_wanted: bool,
    inputs: Inputs,
}

/// What the shader depends on, besides its object.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Inputs {
    pub seconds: f32,
    pub uniforms: Vec<Vec4>,
    /// Changes with every new input, and with the shader.
    pub version: u64,
}

impl VertexShader {
    /// Returns whether meshes will have to be posed.
    pub(super) fn is_wanted(&self) -> bool {
        self.is_wanted
    }

    /// What the shader depends on; `None` if there is none.
    pub(super) fn inputs(&self) -> Option<&Inputs> {
        self.module.is_there().then_some(&self.inputs)
    }
}

/// Passes the app's shader to the renderer under the name by which `pose.wesl` imports it.
pub(in crate::scene) fn extract_vertex_shader(
    own: Extract<Option<Res<ReflectedVertexShader>>>,
    time: Extract<Option<Res<Time>>>,
    shaders: Extract<Res<Assets<Shader>>>,
    mut events: Extract<MessageReader<AssetEvent<Shader>>>,
    state: Option<ResMut<VertexShader>>,
    mut cache: ResMut<PipelineCache>,
) {
    let Some(mut state) = state else { return };
    let VertexShader {
        module,
        is_wanted,
        inputs,
    } = &mut *state;
    *is_wanted = own.is_some();
    let wanted = own.as_ref().map(|own| own.shader.id());
    let is_new = module.follow(&PLACE, wanted, &shaders, &mut events, &mut cache);
    let Some(own) = &*own else { return };
    let seconds = match &*time {
        Some(time) if own.animated => time.elapsed_secs_wrapped(),
        _ => 0.0,
    };
    if is_new || inputs.seconds != seconds || inputs.uniforms != own.uniforms {
        inputs.seconds = seconds;
        inputs.uniforms.clone_from(&own.uniforms);
        inputs.version += 1;
    }
}

/// What the shader gets of an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Motion {
    pub world_from_object: Affine3A,
    object_from_world: Affine3A,
    reach: f32,
    parameters: Vec4,
}

impl Motion {
    /// Returns `None` for a transform without an inverse: vertices can't return from world space.
    pub fn new(world_from_object: Affine3A, vertices: &ReflectedVertices) -> Option<Self> {
        let object_from_world = world_from_object.inverse();
        let reach = vertices.reach;
        object_from_world.is_finite().then_some(Self {
            world_from_object,
            object_from_world,
            reach: if reach.is_finite() { reach.max(0.0) } else { 0.0 },
            parameters: vertices.parameters,
        })
    }

    /// The reach in the object's own space, along its axes.
    pub fn reach(&self) -> Vec3 {
        let columns = self.object_from_world.matrix3;
        let rows = columns.transpose();
        if self.reach == 0.0 {
            // A length can be infinite.
            return Vec3::ZERO;
        }
        self.reach * Vec3::new(rows.x_axis.length(), rows.y_axis.length(), rows.z_axis.length())
    }

    /// Words for `PoseJob::motion`.
    pub fn words(&self, seconds: f32) -> [u32; 29] {
        let mut words = [0.0; 29];
        words[..12].copy_from_slice(&rows(&self.world_from_object));
        words[12..24].copy_from_slice(&rows(&self.object_from_world));
        words[24..28].copy_from_slice(&self.parameters.to_array());
        words[28] = seconds;
        words.map(f32::to_bits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::math::Quat;

    #[test]
    fn the_reach_is_that_of_a_sphere_in_object_space() {
        let place = Affine3A::from_scale_rotation_translation(
            Vec3::new(2.0, 0.5, 4.0),
            Quat::from_rotation_y(0.7),
            Vec3::new(1.0, 2.0, 3.0),
        );
        let vertices = |reach| ReflectedVertices {
            reach,
            ..ReflectedVertices::default()
        };
        let reach = Motion::new(place, &vertices(1.0)).unwrap().reach();
        assert!(reach.abs_diff_eq(Vec3::new(0.5, 2.0, 0.25), 1e-6), "{reach}");
        for bad in [-1.0, f32::NAN, f32::INFINITY] {
            assert_eq!(Motion::new(place, &vertices(bad)).unwrap().reach(), Vec3::ZERO);
        }
        let flat = Affine3A::from_scale(Vec3::new(1.0, 0.0, 1.0));
        assert_eq!(Motion::new(flat, &vertices(1.0)), None);
    }
}
