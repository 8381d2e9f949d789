use bevy as _; #[test] fn t(){}
