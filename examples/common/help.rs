//! The keys of an example and what it shows right now: in the log, in the title of the window, and with the crate feature `egui` also
//! over the picture.

use bevy::{prelude::*, window::PrimaryWindow};

/// Keys and what they do.
pub type Keys = &'static [(&'static str, &'static str)];

/// What Bevy's free camera understands in every example.
const FLY: (&str, &str) = ("W A S D Q E", "fly, and look around with the right mouse button");

/// Name, keys and present state of the example.
#[derive(Resource)]
pub struct Help {
    name: &'static str,
    keys: Keys,
    state: String,
}

impl Help {
    /// All keys.
    fn lines(&self) -> impl Iterator<Item = (&'static str, &'static str)> {
        self.keys.iter().copied().chain([FLY])
    }
}

/// Shows keys in the windowed app.
pub fn add(app: &mut App, name: &'static str, keys: Keys) {
    app.insert_resource(Help {
        name,
        keys,
        state: String::new(),
    })
    .add_systems(Startup, log_keys)
    .add_systems(PostUpdate, write_title.run_if(resource_changed::<Help>));
    #[cfg(feature = "egui")]
    overlay::add(app);
}

/// Says what is shown right now; to be called in every frame.
pub fn say(help: &mut ResMut<Help>, state: String) {
    if help.state != state {
        help.state = state;
    }
}

fn log_keys(help: Res<Help>) {
    for (key, effect) in help.lines() {
        info!("{key}: {effect}");
    }
}

fn write_title(help: Res<Help>, mut window: Single<&mut Window, With<PrimaryWindow>>) {
    let keys: Vec<String> = help.lines().map(|(key, effect)| format!("[{key}] {effect}")).collect();
    window.title = format!("{}: {} | {}", help.name, help.state, keys.join(", "));
}

/// The same over the picture.
#[cfg(feature = "egui")]
mod overlay {
    use super::Help;
    use bevy::prelude::*;
    use bevy_egui::{EguiContexts, EguiPlugin, EguiPrimaryContextPass, egui};

    pub fn add(app: &mut App) {
        if !app.is_plugin_added::<EguiPlugin>() {
            app.add_plugins(EguiPlugin::default());
        }
        app.add_systems(EguiPrimaryContextPass, show);
    }

    fn show(mut contexts: EguiContexts, help: Res<Help>) {
        let Ok(context) = contexts.ctx_mut() else { return };
        egui::Window::new(help.name)
            .anchor(egui::Align2::LEFT_TOP, egui::vec2(8.0, 8.0))
            .resizable(false)
            .show(context, |ui| {
                ui.label(&help.state);
                ui.separator();
                for (key, effect) in help.lines() {
                    ui.label(format!("{key}: {effect}"));
                }
            });
    }
}
