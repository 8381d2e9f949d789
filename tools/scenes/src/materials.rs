//! Finishes that several scenes use.

use bevy::prelude::*;

/// A plain dielectric.
pub fn gloss(base_color: Color, perceptual_roughness: f32) -> StandardMaterial {
    StandardMaterial {
        base_color,
        perceptual_roughness,
        ..Default::default()
    }
}

/// A plain metal.
pub fn metal(base_color: Color, perceptual_roughness: f32) -> StandardMaterial {
    StandardMaterial {
        metallic: 1.0,
        ..gloss(base_color, perceptual_roughness)
    }
}

/// An emitter that reflects nothing.
pub fn glow(emissive: LinearRgba) -> StandardMaterial {
    StandardMaterial {
        emissive,
        reflectance: 0.0,
        ..gloss(Color::BLACK, 1.0)
    }
}

/// A surface that shows its colour in any light.
pub fn unlit(base_color: Color) -> StandardMaterial {
    StandardMaterial {
        base_color,
        unlit: true,
        ..Default::default()
    }
}

/// A material in another colour.
pub fn dyed(base: &StandardMaterial, base_color: Color) -> StandardMaterial {
    StandardMaterial {
        base_color,
        ..base.clone()
    }
}

/// A material without its texture's metalness.
pub fn dielectric(material: StandardMaterial) -> StandardMaterial {
    StandardMaterial {
        metallic: 0.0,
        ..material
    }
}

/// A double-sided material.
pub fn both_sides(material: StandardMaterial) -> StandardMaterial {
    StandardMaterial {
        double_sided: true,
        cull_mode: None,
        ..material
    }
}
