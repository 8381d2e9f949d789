//! Adds the resolved reflection to the lit frame by blending.

use crate::{
    gbuffer::{Binding, PassContext},
    pipelines::{Failure, Kind, Options, Pass, Pipelines, Variant},
    scene::Features,
};
use bevy::render::{render_resource::TextureFormat, renderer::RenderContext, view::ViewTarget};

/// The blend pass, with a variant for each frame format.
pub(crate) const ADD: &Pass = &Pass {
    label: "glint_add",
    shader: "composite/add.wesl",
    entry_point: "add",
    kind: Kind::Addition,
    bindings: || vec![Binding::floats(|context| context.targets().reflection.as_ref())],
    ..Pass::new(Failure::COMPOSITE)
};

/// The variant for frames of a format.
pub(super) fn variant(format: TextureFormat) -> Variant {
    Variant {
        format: Some(format),
        ..ADD.variant(Features::empty(), Options::empty())
    }
}

/// Adds the reflection of one view, only inside [`PassContext::area`].
pub(super) fn run(ctx: &mut RenderContext, pipelines: &Pipelines, context: &PassContext, target: &ViewTarget) {
    let variant = variant(target.main_texture_format());
    let targets = [Some(target.get_unsampled_color_attachment())];
    let Some(mut pass) = pipelines.begin_fragments(ctx, context, &variant, &targets) else {
        return;
    };
    let (origin, size) = (context.textures.origin, context.textures.size());
    pass.set_viewport(origin.x as f32, origin.y as f32, size.x as f32, size.y as f32, 0.0, 1.0);
    let area = context.area();
    let first = origin + area.min;
    pass.set_scissor_rect(first.x, first.y, area.width(), area.height());
    pass.draw(0..3, 0..1);
}
