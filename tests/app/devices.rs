//! Devices with fewer features and lower limits show the same image, through copies of textures or through passes with lower requirements.

use crate::{
    pictures::{
        COARSE, PATIENCE, app_of_device, assert_flip, device_without, dump, flip, use_coarse_shadow_maps, warm_up,
    },
    stage::report,
};
use bevy::{
    math::UVec2,
    prelude::*,
    render::settings::{WgpuFeatures, WgpuSettings},
};
use bevy_glint::{ReflectionPreset, ReflectionTextureMode};
use glint_scenes::{SceneName, browser_device};

const SIZE: UVec2 = UVec2::new(120, 80);
/// Frames after which noise hardly makes two images differ.
const FRAMES: u32 = 24;
/// Mean FLIP of two images of one scene. Without reflections it is at least [`OFF`] times as high.
const SAME: f32 = 0.02;
const OFF: f32 = 2.0;

/// A device without some features, with its name.
struct Device {
    name: &'static str,
    settings: WgpuSettings,
}

impl Device {
    fn without(name: &'static str, features: WgpuFeatures) -> Self {
        Self {
            name,
            settings: device_without(features),
        }
    }

    fn lacks(&self) -> WgpuFeatures {
        self.settings.disabled_features.unwrap_or_default()
    }
}

/// Each feature alone, and the device of a browser.
fn devices() -> [Device; 5] {
    [
        Device::without(
            "binding arrays",
            WgpuFeatures::TEXTURE_BINDING_ARRAY
                | WgpuFeatures::BUFFER_BINDING_ARRAY
                | WgpuFeatures::STORAGE_RESOURCE_BINDING_ARRAY,
        ),
        Device::without(
            "timestamps",
            WgpuFeatures::TIMESTAMP_QUERY
                | WgpuFeatures::TIMESTAMP_QUERY_INSIDE_ENCODERS
                | WgpuFeatures::TIMESTAMP_QUERY_INSIDE_PASSES,
        ),
        Device::without("subgroups", WgpuFeatures::SUBGROUP | WgpuFeatures::SUBGROUP_BARRIER),
        Device::without("f16", WgpuFeatures::SHADER_F16),
        Device {
            name: "what browsers lack",
            settings: browser_device(),
        },
    ]
}

/// The image of a device, and its texture mode; `None` if the machine can't trace.
fn picture(device: &Device, reflects: bool) -> Option<(Vec<u8>, Option<ReflectionTextureMode>)> {
    let mut app = app_of_device(SIZE, device.settings.clone())?;
    let got = app.device().expect("an app that traces has a device").features();
    assert!(!got.intersects(device.lacks()), "{}: {got:?}", device.name);
    use_coarse_shadow_maps(&mut app);
    let camera = app.spawn_scene(SceneName::Demo, &COARSE);
    app.world().resource_mut::<Time<Virtual>>().pause();
    if reflects {
        app.world().entity_mut(camera).insert(ReflectionPreset::High.settings());
        warm_up(&mut app);
    } else {
        app.warm_up(PATIENCE).unwrap();
    }
    app.step(FRAMES);
    let textures = report(&mut app).textures;
    Some((app.capture().unwrap(), textures))
}

#[test]
#[ignore = "long: a device and all shaders for each lack"]
fn lesser_devices_show_the_same_picture() {
    let full = Device {
        name: "nothing",
        settings: default(),
    };
    let (Some((expected, textures)), Some((off, _))) = (picture(&full, true), picture(&full, false)) else {
        return;
    };
    println!("{}: {textures:?}", full.name);
    let difference = flip(SIZE, &expected, &off).0;
    assert!(difference > OFF * SAME, "reflections are hardly seen: {difference}");
    for device in devices() {
        let name = format!("device-without-{}", device.name.replace(' ', "-"));
        let (actual, textures) = picture(&device, true).expect("the full device traces");
        println!("{name}: {textures:?}");
        assert_flip(&name, SIZE, &expected, &actual, SAME);
        dump(&name, SIZE, &expected, &actual);
        let has_layers = matches!(textures, Some(ReflectionTextureMode::Layers { .. }));
        let lacks_arrays = device.lacks().contains(WgpuFeatures::TEXTURE_BINDING_ARRAY);
        assert_eq!(has_layers, lacks_arrays, "{name}");
    }
}
