//! Components of the crate in Bevy's scene notation.

use bevy::{camera::Hdr, core_pipeline::prepass::NormalPrepass, prelude::*, scene::ScenePlugin};
use bevy_glint::{GrazingThresholds, prelude::*};

#[test]
fn a_scene_describes_a_camera_that_reflects() {
    let mut app = App::new();
    app.add_plugins((
        MinimalPlugins,
        AssetPlugin::default(),
        ScenePlugin,
        RayTracedReflectionsPlugin::default(),
    ));
    app.init_asset::<Mesh>();
    let thresholds = GrazingThresholds::default();
    let scene = bsn! {
        #Camera
        Camera3d
        RayTracedReflections { roughness_cutoff: 0.6, transparent: false }
        ReflectionQuality::High
        ReflectionBudget { milliseconds: 1.5 }
        ShadingRateHeuristic::Grazing({ thresholds })
        Children [
            NotReflected
            ReflectedMesh3d("chair.glb#Mesh0/Primitive0")
            --
            ReflectedPose::Rigid
        ]
    };
    let id = match app.world_mut().spawn_scene(scene) {
        Ok(camera) => camera.id(),
        Err(error) => panic!("{error}"),
    };
    let camera = app.world().entity(id);
    let expected = RayTracedReflections {
        roughness_cutoff: 0.6,
        transparent: false,
        ..default()
    };
    assert_eq!(camera.get(), Some(&expected), "other fields keep their defaults");
    assert_eq!(camera.get(), Some(&ReflectionQuality::High));
    assert_eq!(camera.get(), Some(&ShadingRateHeuristic::Grazing(thresholds)));
    let children: Vec<_> = camera.get::<Children>().into_iter().flatten().copied().collect();
    let [hidden, rigid] = children[..] else {
        panic!("two children, not {children:?}");
    };
    let hidden = app.world().entity(hidden);
    assert!(hidden.contains::<NotReflected>());
    let path = hidden.get::<ReflectedMesh3d>().and_then(|mesh| mesh.0.path());
    assert_eq!(
        path.map(ToString::to_string).as_deref(),
        Some("chair.glb#Mesh0/Primitive0")
    );
    assert_eq!(app.world().entity(rigid).get(), Some(&ReflectedPose::Rigid));
    app.update();
    let camera = app.world().entity(id);
    assert!(camera.contains::<Hdr>() && camera.contains::<NormalPrepass>());
}
