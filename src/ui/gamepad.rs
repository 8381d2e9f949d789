//! The keys by which egui moves its focus, from a gamepad.

use bevy::{
    ecs::prelude::*,
    input::gamepad::{Gamepad, GamepadButton},
};
use bevy_egui::{
    PrimaryEguiContext,
    egui::{Event, Key, Modifiers},
    input::EguiInputEvent,
};

/// Buttons of the directional pad choose a widget and move sliders; the lower and the right face button press it and close lists.
const KEYS: [(GamepadButton, Key, Modifiers); 6] = [
    (GamepadButton::DPadDown, Key::Tab, Modifiers::NONE),
    (GamepadButton::DPadUp, Key::Tab, Modifiers::SHIFT),
    (GamepadButton::DPadLeft, Key::ArrowLeft, Modifiers::NONE),
    (GamepadButton::DPadRight, Key::ArrowRight, Modifiers::NONE),
    (GamepadButton::South, Key::Enter, Modifiers::NONE),
    (GamepadButton::East, Key::Escape, Modifiers::NONE),
];

/// Presses keys.
pub(super) fn press_keys(
    gamepads: Query<&Gamepad>,
    contexts: Query<Entity, With<PrimaryEguiContext>>,
    mut events: MessageWriter<EguiInputEvent>,
) {
    let Some(context) = contexts.iter().next() else { return };
    for (button, key, modifiers) in KEYS {
        for pressed in [true, false] {
            let changed = |gamepad: &Gamepad| match pressed {
                true => gamepad.just_pressed(button),
                false => gamepad.just_released(button),
            };
            if gamepads.iter().any(changed) {
                let event = Event::Key {
                    key,
                    physical_key: None,
                    pressed,
                    repeat: false,
                    modifiers,
                };
                events.write(EguiInputEvent { context, event });
            }
        }
    }
}
