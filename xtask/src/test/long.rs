//! The second tier: long tests, module by module.

use std::mem;
use std::slice;
use std::time::{Duration, Instant, SystemTime};

use super::{Limits, Options, Results, Suite, TRACER, Test};
use crate::cases::Case;
use crate::progress::Times;

/// Tests of one module of a program and one tracer, which share their results in one process.
type Group = (String, Vec<Case>);

/// Runs long tests: all of them, or as many modules as begin before a point in time. In the latter case each run begins at another module,
/// so that none is skipped for long.
pub fn run(
    suite: &Suite,
    options: &Options,
    tests: &[(String, Case)],
    end: Option<Instant>,
    times: &mut Times,
) -> Results {
    let mut groups = groups(tests);
    if end.is_some() && !groups.is_empty() {
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        let first = now.unwrap_or(Duration::ZERO).as_secs() as usize % groups.len();
        groups.rotate_left(first);
    }
    let mut results = Results::default();
    let mut commands = Vec::new();
    groups.retain(|group| {
        let (program, cases) = group;
        let Some(mut test) = suite.programs.iter().map(Test::new).find(|test| test.name == *program) else {
            results.leave_out(slice::from_ref(group));
            return false;
        };
        test.part = describe(cases);
        match &cases[0].variant {
            Some(tracer) => test.command.env(TRACER, tracer),
            // Both tracers take twice the time.
            None if end.is_none() => test.command.arg("--ignored").env(TRACER, "all"),
            None => test.command.arg("--ignored"),
        };
        test.command.arg("--exact");
        test.command.args(cases.iter().map(|case| &case.name));
        commands.push(test);
        true
    });
    // Some at a time: most of them wait for one thread now and then.
    let limits = Limits {
        end,
        ..Limits::of(options)
    };
    let (mut all, late) = suite.run_all("long tests", commands, limits, times);
    // Tests that are long in both tiers were found anew.
    all.long = mem::take(&mut results.long);
    all.leave_out(&groups[groups.len() - late..]);
    all
}

impl Results {
    fn leave_out(&mut self, groups: &[Group]) {
        for (program, cases) in groups {
            self.long
                .extend(cases.iter().map(|case| (program.clone(), case.clone())));
        }
    }
}

/// The module and the tracer of a group.
fn describe(cases: &[Case]) -> String {
    let variant = cases[0].variant.as_deref().unwrap_or_default();
    format!("{} {variant}", cases[0].module()).trim_end().to_owned()
}

/// Joins the tests of each module.
fn groups(tests: &[(String, Case)]) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    for (program, case) in tests {
        match groups.iter_mut().find(|(other, cases)| {
            let first = &cases[0];
            other == program && first.module() == case.module() && first.variant == case.variant
        }) {
            Some((_, cases)) => cases.push(case.clone()),
            None => groups.push((program.clone(), vec![case.clone()])),
        }
    }
    groups
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tests_of_a_module_run_together() {
        let test = |program: &str, name: &str| {
            let case = Case::parse(&format!("test {name} ... ignored, long: many frames")).unwrap();
            (program.to_owned(), case)
        };
        let tests = [
            test("p", "a::x"),
            test("p", "b::y"),
            test("q", "a::x"),
            test("p", "a::z"),
        ];
        let groups = groups(&tests);
        let sizes: Vec<_> = groups
            .iter()
            .map(|(program, cases)| (program.as_str(), cases.len()))
            .collect();
        assert_eq!(sizes, [("p", 2), ("p", 1), ("q", 1)]);
    }
}
