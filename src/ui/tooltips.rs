//! Tooltip of each setting in the panel: sentences of the setting's documentation, which a test verifies.

/// Declares a text for each item: its file, its path in there, and the first sentences of its documentation, without markup.
macro_rules! tooltips {
    ($($name:ident: $file:ident, $item:literal = $text:literal;)+) => {
        $(pub(super) const $name: &str = $text;)+
        #[cfg(test)]
        const ALL: &[(&str, &str, &str)] = &[$((stringify!($file), $item, $text)),+];
    };
}

tooltips! {
    TECHNIQUE: settings, "RayTracedReflections::technique" =
        "How many rays are traced and what becomes of them. Default: ReflectionTechnique::Variable.";
    BACKEND: settings, "RayTracedReflections::backend" =
        "Back end that turns the rate image into fewer rays. Default: ReflectionBackend::Auto.";
    SAMPLING: settings, "RayTracedReflections::sampling" =
        "How the directions of rays are drawn. Default: ReflectionSampling::BlueNoise.";
    FULL_RESOLUTION_MIRRORS: settings, "RayTracedReflections::full_resolution_mirrors" =
        "Trace exact mirrors (perceptual roughness up to 0.03) with one ray for each pixel of the full resolution, \
         and leave them out of the denoiser: sharp and free of ghosts, for up to four times the rays on such \
         surfaces. Default: true. The paper has no such step.";
    ROUGHNESS_CUTOFF: settings, "RayTracedReflections::roughness_cutoff" =
        "Perceptual roughness (0 to 1) above which a surface gets no ray and keeps the environment map. More \
         reflects rougher surfaces, with more rays. The G-buffer stores 8 bits, so that the border is exact to \
         1/255. Default: 0.6.";
    ROUGHNESS_FADE: settings, "RayTracedReflections::roughness_fade" =
        "Width of the band of perceptual roughness below roughness_cutoff in which the traced reflection fades into \
         the environment map; 0 is a hard edge. Default: 0.1.";
    MAX_RAY_LENGTH: settings, "RayTracedReflections::max_ray_length" =
        "Length of a reflection ray in metres. Longer rays see more and cost more; what lies behind their end is \
         replaced by the environment. Default: 10,000.";
    SHADOW_RAYS: settings, "RayTracedReflections::shadow_rays" =
        "Traces shadow rays from what reflections see to the lights that cast shadows: one more ray for each light \
         and hit. Without, light leaks through walls in reflections. Default: true.";
    TEXTURE_MIP: settings, "RayTracedReflections::texture_mip" =
        "Which mip level of a texture is read where a ray hits. Default: ReflectionTextureMip::RayCone.";
    RESET: settings, "RayTracedReflections::reset" =
        "Forgets all history in the next frame: set it when the camera jumps. It clears itself. Default: true, so \
         that a new component starts clean.";
    TECHNIQUE_REFERENCE: settings, "ReflectionTechnique::Reference" =
        "One ray for each pixel of each frame: the paper's full-resolution reference. Four times the rays of \
         Quarter.";
    TECHNIQUE_QUARTER: settings, "ReflectionTechnique::Quarter" =
        "One ray for each quad of 2x2 pixels: 1/4 ray per pixel.";
    TECHNIQUE_QUARTER_INLINE: settings, "ReflectionTechnique::QuarterInline" =
        "The rays of Quarter from a full-screen fragment pass without a rate image: the paper's baseline for \
         hardware variable rate shading. Elsewhere there is no reason to prefer it.";
    TECHNIQUE_VARIABLE: settings, "ReflectionTechnique::Variable" =
        "One ray for each block of up to 4x4 quads, as large as the camera's ShadingRateHeuristic allows: the \
         paper's technique (section 4.1).";
    TECHNIQUE_CONVERGED: settings, "ReflectionTechnique::Converged" =
        "One ray for each pixel, averaged over all frames since the camera, a setting, the environment or the scene \
         last changed: the ground truth of a still scene. It begins anew by itself, so that it stays noisy while \
         anything moves.";
    BACKEND_AUTO: settings, "ReflectionBackend::Auto" =
        "Compute, which works everywhere and leaves no lanes idle.";
    BACKEND_COMPUTE: settings, "ReflectionBackend::Compute" =
        "A list of rays and an indirect dispatch.";
    BACKEND_HARDWARE: settings, "ReflectionBackend::HardwareVrs" =
        "A full-screen pass with a shading-rate attachment: Vulkan with VK_KHR_fragment_shading_rate, the crate \
         feature hardware-vrs, and HardwareVrsPlugin before DefaultPlugins. Falls back to compute, with a warning, \
         where one of that is missing (ReflectionStatusReport::active_backends). Rates that the GPU lacks are replaced by \
         finer ones. Only for ReflectionTechnique::Variable; the others don't vary their rate.";
    SAMPLING_BLUE_NOISE: settings, "ReflectionSampling::BlueNoise" =
        "Bounded visible normals (Eto and Tokuyoshi 2023) from spatio-temporal blue noise: the least noise.";
    SAMPLING_HALTON: settings, "ReflectionSampling::Halton" =
        "All normals of the GGX distribution from a Halton sequence with a Cranley-Patterson rotation: the paper's \
         section 4.1.1.";
    MIP_RAY_CONE: settings, "ReflectionTextureMip::RayCone" =
        "The level that fits the footprint of the ray, from a cone that widens with distance and roughness \
         (Akenine-Möller et al., Ray Tracing Gems, chapter 20).";
    MIP_FIXED: settings, "ReflectionTextureMip::Fixed" =
        "Always the same level. The paper uses 2 (section 4.1.1).";
    DENOISER_SAMPLES: settings, "ReflectionDenoiser::samples" =
        "Rays of neighbours that a pixel is reconstructed from, 1 to 16. More is smoother and costs time. With one, \
         and one ray per pixel, each pixel shows its own ray. Default: 8.";
    DENOISER_TEMPORAL: settings, "ReflectionDenoiser::temporal" =
        "Accumulates results over frames. Default: true.";
    DENOISER_MAX_HISTORY: settings, "ReflectionDenoiser::max_history" =
        "Frames that a rough surface accumulates at most, 1 to 255. Smoother surfaces keep fewer. More is less \
         noise and slower change of what is reflected. Default: 32.";
    DENOISER_VIRTUAL_HISTORY: settings, "ReflectionDenoiser::virtual_history" =
        "Keeps a second history that follows the reflected image, not the surface: glossy surfaces stay sharp \
         under a moving camera. The paper has only the history of the surface. Default: true.";
    DENOISER_CLIP_SIGMA: settings, "ReflectionDenoiser::clip_sigma" =
        "Standard deviations of the neighbourhood that history may differ by, 0.5 to 10; less has less ghosting and \
         more noise. Default: 1.5.";
    DENOISER_SUPPRESS_FIREFLIES: settings, "ReflectionDenoiser::suppress_fireflies" =
        "Dims rays far brighter than their neighbours before they enter the history; a small loss of \
         energy for no fireflies. Default: true. The paper has no such step.";
    DENOISER_CONVERGE_STATIC_VIEWS: settings, "ReflectionDenoiser::converge_static_views" =
        "Lets static views converge: while neither the camera nor the scene changes, all frames sample the same, \
         so that history is neither clipped nor dimmed and spans up to eight times max_history, 240 frames at most. \
         Off, a still picture keeps the small losses of a moving one. Default: true. The paper has no such step.";
    DENOISER_BLUR_RADIUS: settings, "ReflectionDenoiser::blur_radius" =
        "Radius in pixels of the last blur where the variance is highest, 0 (off) to 8. Default: 3.";
    TRACER: plugin, "RayTracedReflectionsPlugin::tracer" =
        "Tracer that finds the surfaces that rays hit; fixed for the life of the app. Default: ReflectionTracerChoice::Auto.";
    PRESET_PAPER: presets, "ReflectionPreset::Paper" =
        "The paper's recipe step by step: a quarter of the resolution, rates from average roughness (table 1), GGX \
         normals from a Halton sequence, mip level 2 at hits, one history, no step of ours, no cut-off. 1/16 to 1/4 \
         ray per pixel.";
    PRESET_LOW: presets, "ReflectionPreset::Low" =
        "Smooth surfaces only, few samples, no shadow rays in reflections. 1/16 to 1/4 ray per pixel.";
    PRESET_MEDIUM: presets, "ReflectionPreset::Medium" =
        "The default of RayTracedReflections. 1/16 to 1/4 ray per pixel.";
    PRESET_HIGH: presets, "ReflectionPreset::High" =
        "Every quad gets its ray, rougher surfaces reflect as well. 1/4 ray per pixel.";
    PRESET_ULTRA: presets, "ReflectionPreset::Ultra" =
        "Every pixel gets its ray. 1 ray per pixel.";
    HEURISTIC: heuristic, "ShadingRateHeuristic" =
        "How a camera with ReflectionTechnique::Variable decides how many rays each tile of its screen gets; ignored with \
         other techniques.";
    HEURISTIC_UNIFORM: heuristic, "ShadingRateHeuristic::Uniform" =
        "The same rate everywhere.";
    HEURISTIC_ROUGHNESS: heuristic, "ShadingRateHeuristic::Roughness" =
        "By the average roughness of a tile: what is blurred needs fewer rays (the paper's section 4.1).";
    HEURISTIC_GRAZING: heuristic, "ShadingRateHeuristic::Grazing" =
        "By the average angle of a tile's surfaces to the viewer: surfaces seen head-on reflect less than grazing \
         ones (the paper's section 4.1).";
    HEURISTIC_COMBINED: heuristic, "ShadingRateHeuristic::Combined" =
        "By the size of the lobe on the screen, by how much of it can be seen, and by the shape of what is in the \
         tile: more quality for the same rays. The default.";
    HEURISTIC_CUSTOM: heuristic, "ShadingRateHeuristic::Custom" =
        "A heuristic of your own: a WESL module with one compute entry point, built on bevy_glint::rate::tile \
         (src/rate/tile.wesl says how).";
    HEURISTIC_IMAGE: heuristic, "ShadingRateHeuristic::Image" =
        "A rate image of your own, for foveated rendering or experiments: one texel per tile from the top left, \
         each a ShadingRate::code, in the format R8Uint or R32Uint.";
    ROUGHNESS_HALF: heuristic, "RoughnessThresholds::half" =
        "Average roughness from which a tile gets 2x1 (table 1 of the paper). Default: 0.25.";
    ROUGHNESS_QUARTER: heuristic, "RoughnessThresholds::quarter" =
        "Average roughness from which a tile gets 2x2 (table 1 of the paper). Default: 0.75.";
    ROUGHNESS_MIN_ROUGHNESS: heuristic, "RoughnessThresholds::min_roughness" =
        "A tile with a pixel less rough than this keeps 1x1, so that a mirror in a rough tile isn't averaged away; \
         None leaves this out, as the paper does. Default: 0.1.";
    GRAZING_HALF: heuristic, "GrazingThresholds::half" =
        "Average cosine above which a tile gets 2x1 (table 1 of the paper: 1x1 up to it). Default: 0.5.";
    GRAZING_QUARTER: heuristic, "GrazingThresholds::quarter" =
        "Average cosine from which a tile gets 2x2 (table 1 of the paper: 2x1 below it). Default: 0.75.";
    GRAZING_MIN_ROUGHNESS: heuristic, "GrazingThresholds::min_roughness" =
        "As in RoughnessThresholds::min_roughness. Default: 0.1.";
    COMBINED_HALF: heuristic, "CombinedThresholds::half" =
        "Perceptual roughness from which two trace pixels share a ray. Default: 0.25, as in table 1 of the paper.";
    COMBINED_QUARTER: heuristic, "CombinedThresholds::quarter" =
        "Perceptual roughness from which four share a ray on surfaces seen head-on; it grows to 1.5 times this at \
         grazing angles. Default: 0.5.";
    COMBINED_EIGHTH: heuristic, "CombinedThresholds::eighth" =
        "Perceptual roughness from which eight share a ray, and as above sixteen, where coarsest allows it. \
         Default: 0.75.";
    COMBINED_MIN_ROUGHNESS: heuristic, "CombinedThresholds::min_roughness" =
        "Least roughness in a tile below which it keeps 1x1; None leaves this out. Default: 0.1.";
    COMBINED_VISIBILITY_THRESHOLD: heuristic, "CombinedThresholds::visibility_threshold" =
        "Share of the reflection in what a pixel shows under even light (0 to 1) below which it is faint. 0 leaves \
         this out. Default: 0.1.";
    COMBINED_EDGE: heuristic, "CombinedThresholds::edge" =
        "Deviation of the normals in a tile, as an angle in radians (root of the mean square), above which the tile \
         counts as an edge. Infinity leaves this out. Default: 0.25.";
    COMBINED_COARSEST: heuristic, "CombinedThresholds::coarsest" =
        "No tile gets a coarser rate; a wide rate stands for the tall one, too. Default: 2x2. Above that, what \
         touches a rough surface can lose its contact reflection, since distances of hits aren't known beforehand.";
    TILE_SIZE: heuristic, "ShadingRateTileSize" =
        "Size of the tiles that share a rate.";
    TILE_SIZE_16: heuristic, "ShadingRateTileSize::Tiles16" =
        "16x16 trace pixels, as in the paper.";
    TILE_SIZE_8: heuristic, "ShadingRateTileSize::Tiles8" =
        "8x8 trace pixels: rates follow the picture more closely, for a little more time.";
    DEBUG_OFF: debug, "ReflectionDebugView::Off" =
        "The picture.";
    DEBUG_REFLECTION: debug, "ReflectionDebugView::Reflection" =
        "The reflection alone: exactly what is added to the lit frame, on black. It is negative where ambient light \
         that Bevy added is taken back.";
    DEBUG_SHADING_RATES: debug, "ReflectionDebugView::ShadingRates" =
        "The colour of each tile's rate after RATE_LEGEND over the brightness of the picture; darker where nothing \
         reflects. Exact mirrors with rays of their own have a colour of theirs.";
    DEBUG_RAYS_PER_PIXEL: debug, "ReflectionDebugView::RaysPerPixel" =
        "Heat of the reflection rays per pixel of the view, by its logarithm: blue 1/64, cyan 1/23, green 1/8, \
         yellow 1/3, red 1. The ray of a block counts in equal parts for its pixels.";
    DEBUG_RAW_RAYS: debug, "ReflectionDebugView::RawRays" =
        "Radiance that rays brought, before any weight: a block of pixels shows the one ray that it shares. Exact \
         mirrors with rays of their own are not in it.";
    DEBUG_HIT_DISTANCE: debug, "ReflectionDebugView::HitDistance" =
        "Heat of the distance from the surface to what it reflects, as reconstruction found it, by its logarithm: \
         blue 0.1 m, cyan 1 m, green 10 m, yellow 100 m, red 1,000 m. White is the sky.";
    DEBUG_RECONSTRUCTED: debug, "ReflectionDebugView::Reconstructed" =
        "Radiance of each pixel's lobe divided by the lobe's albedo after the whole denoiser: what the composite \
         reads. In a white furnace it is white.";
    DEBUG_HISTORY_LENGTH: debug, "ReflectionDebugView::HistoryLength" =
        "Heat of the length of each pixel's history in frames: blue 0, red max_history and more. With \
         ReflectionTechnique::Converged the frames that were averaged.";
    DEBUG_VARIANCE: debug, "ReflectionDebugView::Variance" =
        "Heat of the relative variance (the variance over the squared mean) of one frame's radiance, by its \
         logarithm: blue 0.0001, cyan 0.003, green 0.1, yellow 3, red 100. Without temporal accumulation that of \
         the mean of the rays that a pixel was reconstructed from.";
    DEBUG_RAY_WEIGHT: debug, "ReflectionDebugView::RayWeight" =
        "Heat of the mean weight of the rays that a pixel was reconstructed from, relative to its expectation, by \
         its logarithm: blue 1/16, cyan 1/4, green 1, yellow 4, red 16. Black where there was no ray. A frame counts \
         in a pixel's history by this weight.";
    DEBUG_REJECTED: debug, "ReflectionDebugView::Rejected" =
        "Red where a pixel's history holds at most one frame: it is new, or its past was rejected. Not exact \
         mirrors with rays of their own, which have no history.";
    DEBUG_NON_FINITE: debug, "ReflectionDebugView::NonFinite" =
        "Magenta where anything that the passes keep of a pixel is not finite; yellow where only the picture itself \
         is not.";
    SPLIT: debug, "ReflectionDebugSplit" =
        "Divides the picture of a camera: its ReflectionDebugView is shown right of a thin white line.";
    SPLIT_POSITION: debug, "ReflectionDebugSplit::position" =
        "Position of the line: 0 is the left edge of the view, 1 the right one; clamped, and NaN is the middle. \
         Default: 0.5.";
    SPLIT_LEFT: debug, "ReflectionDebugSplit::left" =
        "View that is shown left of the line. Default: ReflectionDebugView::Off, the picture.";
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The lines of documentation of `Type` or `Type::member`.
    fn documentation<'a>(source: &'a str, item: &str) -> Vec<&'a str> {
        let (owner, member) = item
            .split_once("::")
            .map_or((item, None), |(owner, member)| (owner, Some(member)));
        let mut lines = Vec::new();
        let mut in_owner = false;
        for line in source.lines() {
            let code = line.trim();
            if let Some(text) = code.strip_prefix("///") {
                lines.push(text.trim());
                continue;
            }
            if code.starts_with("#[") {
                continue;
            }
            let named = code
                .strip_prefix("pub struct ")
                .or_else(|| code.strip_prefix("pub enum "));
            if let Some(rest) = named {
                in_owner = word(rest) == owner;
                if in_owner && member.is_none() {
                    return lines;
                }
            } else if line.starts_with('}') {
                in_owner = false;
            } else if in_owner && Some(word(code.strip_prefix("pub ").unwrap_or(code))) == member {
                return lines;
            }
            lines.clear();
        }
        panic!("{item} is not documented");
    }

    fn word(text: &str) -> &str {
        let end = text.find(|letter: char| !(letter.is_alphanumeric() || letter == '_'));
        &text[..end.unwrap_or(text.len())]
    }

    /// The first paragraph as a reader sees it: no code marks, no emphasis, no targets of links.
    fn first_paragraph(lines: &[&str]) -> String {
        let end = lines.iter().position(|line| line.is_empty()).unwrap_or(lines.len());
        let text = lines[..end].join(" ");
        let mut plain = String::new();
        let mut letters = text.chars().peekable();
        while let Some(letter) = letters.next() {
            match letter {
                '`' | '*' | '[' => {}
                ']' => {
                    if letters.peek() == Some(&'(') {
                        while letters.next().is_some_and(|letter| letter != ')') {}
                    }
                }
                _ => plain.push(letter),
            }
        }
        plain
    }

    #[test]
    fn tooltips_are_whole_sentences_of_the_documentation() {
        for (file, item, text) in ALL {
            let source = match *file {
                "settings" => concat!(
                    include_str!("../settings/reflections.rs"),
                    include_str!("../settings/denoiser.rs")
                ),
                "presets" => include_str!("../settings/presets.rs"),
                "heuristic" => include_str!("../settings/heuristic.rs"),
                "debug" => include_str!("../settings/debug.rs"),
                "plugin" => include_str!("../plugin.rs"),
                _ => panic!("{file} is not read"),
            };
            let paragraph = first_paragraph(&documentation(source, item));
            let rest = paragraph.strip_prefix(text);
            assert!(
                text.ends_with('.') && rest.is_some_and(|rest| rest.is_empty() || rest.starts_with(' ')),
                "{item}: the tooltip is\n{text}\nbut the documentation says\n{paragraph}"
            );
        }
    }
}
