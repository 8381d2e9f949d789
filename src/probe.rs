//! Queries the capabilities of the device at startup, and reports the choices with their reasons.

use crate::{
    device::{ChosenTracer, FragmentRays, WritesInPlace, adapter_name, choose_tracer, texture_mode, unsupported},
    settings::ReflectionTracerChoice,
    status::ReflectionStatus,
};
use bevy::{
    app::{App, Plugin},
    log::{info, warn},
    render::{
        GpuResourceAppExt, RenderApp,
        renderer::{RenderAdapterInfo, RenderDevice},
        settings::Backends,
    },
};

/// Chooses the tracer. If nothing can be traced, it reports that, and the other plugins add no systems.
///
/// Must be added before all plugins that add systems, since plugins finish in the order in which they were added.
pub(crate) struct ProbePlugin {
    pub tracer: ReflectionTracerChoice,
}

impl Plugin for ProbePlugin {
    fn build(&self, _app: &mut App) {}

    fn finish(&self, app: &mut App) {
        let status = app.world().resource::<ReflectionStatus>().clone();
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else {
            return;
        };
        let Some(device) = render_app.world().get_resource::<RenderDevice>() else {
            return;
        };
        let info = render_app.world().get_resource::<RenderAdapterInfo>();
        let adapter = info.map(adapter_name).unwrap_or_default();
        let backend = info.map_or(Backends::NOOP, |info| info.backend.into());
        let (tracer, reasons) = choose_tracer(self.tracer, device.features(), &device.limits());
        if let Some(reason) = unsupported(backend, &device.limits(), tracer) {
            warn!("ray-traced reflections are off on {adapter}: {reason}");
            status.update(|report| {
                report.adapter = adapter;
                report.reasons = vec![reason];
            });
            return;
        }
        let fragment_rays = FragmentRays::new(tracer, info.map(|info| info.device_type));
        let textures = texture_mode(device);
        status.update(|report| {
            report.adapter = adapter;
            report.tracer = Some(tracer);
            report.textures = Some(textures);
            report.reasons = reasons;
        });
        info!("{}", status.report());
        render_app
            .insert_resource(status)
            .insert_resource(ChosenTracer(tracer))
            .insert_resource(fragment_rays)
            .init_gpu_resource::<WritesInPlace>();
    }
}
