//! Scenes whose keys have wrong, extreme and missing values: each is refused with an error or computed, and nothing panics.

#![cfg(feature = "cli")]

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

use serde_json::Value as Json;
use softarm::mechanics::{NodeWrenches, Stepper};
use softarm::scene::{Scene, builtin};
use softarm::stop::StopSignal;
use toml::{Table, Value};

/// Number of scenes.
const N_SCENES: u64 = 4000;
/// Least part of them that is read without an error, so that what comes after the reading is tried too.
const LEAST_READ: f64 = 0.05;
/// Time after which work on a scene is stopped: more would test the same code for longer, and less would still test the reading.
const PATIENCE: Duration = Duration::from_millis(15);
/// Steps of a simulation.
const N_STEPS: usize = 20;

/// A place in a scene: keys of tables, and indices of lists.
type Path = Vec<String>;

/// Returns the places of all values in a table, those of tables and lists among them.
fn places(value: &Value, at: &Path, out: &mut Vec<Path>) {
    let below: Vec<(String, &Value)> = match value {
        Value::Table(table) => table
            .iter()
            .map(|(key, value)| (key.clone(), value))
            .collect(),
        Value::Array(items) => (items.iter().enumerate())
            .map(|(i, value)| (i.to_string(), value))
            .collect(),
        _ => Vec::new(),
    };
    for (key, value) in below {
        let mut place = at.clone();
        place.push(key);
        out.push(place.clone());
        places(value, &place, out);
    }
}

fn child<'a>(value: &'a mut Value, key: &str) -> Option<&'a mut Value> {
    match value {
        Value::Table(table) => table.get_mut(key),
        Value::Array(items) => items.get_mut(key.parse::<usize>().ok()?),
        _ => None,
    }
}

/// Applies a change to the table or list that holds a place, with the last key of the place.
fn change(scene: &mut Value, place: &Path, with: impl FnOnce(&mut Value, &str)) {
    let Some((last, parents)) = place.split_last() else {
        return;
    };
    let mut at = scene;
    for key in parents {
        match child(at, key) {
            Some(next) => at = next,
            None => return,
        }
    }
    with(at, last);
}

/// Returns a value that the key may not expect; `old` is the one that it has.
fn odd(dice: &mut fastrand::Rng, old: Option<&Value>) -> Value {
    let numbers = [
        0.0,
        -0.0,
        1.0,
        -1.0,
        0.5,
        1e-300,
        5e-324,
        1e300,
        -1e300,
        1e12,
        1e-12,
        f64::INFINITY,
        f64::NEG_INFINITY,
        f64::NAN,
    ];
    match dice.u32(0..12) {
        0..4 => Value::Float(numbers[dice.usize(..numbers.len())]),
        4 => Value::Integer([0, -1, 1, 2, 7, 1 << 40, i64::MAX, i64::MIN][dice.usize(..8)]),
        5 => Value::String(
            ["", "x", "tip", "auto", "free", "\u{1f419}", "rest"][dice.usize(..7)].into(),
        ),
        6 => Value::Boolean(dice.bool()),
        7 => {
            let n = [0, 1, 2, 3, 4, 7, 300][dice.usize(..7)];
            let number = numbers[dice.usize(..numbers.len())];
            Value::Array(vec![Value::Float(number); n])
        }
        8 => {
            let row = |t: f64| Value::Array(vec![Value::Float(t), Value::Float(dice.f64())]);
            Value::Array([0.0, 1.0, 0.5].map(row).to_vec())
        }
        9 => Value::Table(Table::new()),
        _ => match old {
            Some(Value::Float(x)) => {
                let factors = [-1.0, 1e-9, 1e-3, 0.1, 3.0, 1e3, 1e9];
                Value::Float(x * factors[dice.usize(..factors.len())])
            }
            Some(Value::Integer(n)) => {
                Value::Integer(n.wrapping_mul([-1, 0, 2, 50][dice.usize(..4)]))
            }
            Some(Value::Array(items)) => {
                let mut items = items.clone();
                match items.first().cloned() {
                    Some(first) if dice.bool() => items.push(first),
                    _ => {
                        items.pop();
                    }
                }
                Value::Array(items)
            }
            _ => Value::Float(dice.f64()),
        },
    }
}

/// Returns the places of all keys of the schema, with lists by their first item.
fn keys_of_schema() -> Vec<Path> {
    fn walk(schema: &Json, root: &Json, at: &Path, depth: usize, out: &mut Vec<Path>) {
        if depth > 9 {
            return;
        }
        let named = schema["$ref"].as_str();
        if let Some(found) = named.and_then(|name| root.pointer(&name[1..])) {
            walk(found, root, at, depth + 1, out);
        }
        for of in ["anyOf", "oneOf", "allOf"] {
            for part in schema[of].as_array().into_iter().flatten() {
                walk(part, root, at, depth + 1, out);
            }
        }
        if schema["items"].is_object() {
            let mut place = at.clone();
            place.push("0".into());
            walk(&schema["items"], root, &place, depth + 1, out);
        }
        for (key, part) in schema["properties"].as_object().into_iter().flatten() {
            let mut place = at.clone();
            place.push(key.clone());
            out.push(place.clone());
            walk(part, root, &place, depth + 1, out);
        }
    }
    let schema = Scene::schema();
    let mut out = Vec::new();
    walk(&schema, &schema, &Vec::new(), 0, &mut out);
    out.sort();
    out.dedup();
    out
}

/// Sets a key that may be absent, with the tables and lists on the way to it.
fn put(scene: &mut Value, place: &Path, value: Value) {
    let Some((last, parents)) = place.split_last() else {
        return;
    };
    let mut at = scene;
    for (i, key) in parents.iter().enumerate() {
        let is_list = (place.get(i + 1)).is_some_and(|next| next.parse::<usize>().is_ok());
        let empty = || match is_list {
            true => Value::Array(vec![Value::Table(Table::new())]),
            false => Value::Table(Table::new()),
        };
        at = match at {
            Value::Table(table) => table.entry(key.clone()).or_insert_with(empty),
            Value::Array(items) => {
                if items.is_empty() {
                    items.push(empty());
                }
                &mut items[0]
            }
            _ => return,
        };
    }
    match at {
        Value::Table(table) => {
            table.insert(last.clone(), value);
        }
        Value::Array(items) => items.insert(0, value),
        _ => {}
    }
}

/// Reads a scene, and begins all that it describes; tells whether it could be read.
fn begin(text: &str) -> bool {
    let Ok((scene, source)) = Scene::from_toml("fuzz", text, &[]) else {
        return false;
    };
    let until = || StopSignal::at(Instant::now() + PATIENCE);
    if let Ok(setup) = scene.simulation_until(&source, &until()) {
        let stop = until();
        let mut stepper = Stepper::new(&setup.rod, setup.grid.step, setup.initial.clone());
        for _ in 0..N_STEPS.min(setup.grid.n_steps) {
            if stop.is_raised() || stepper.advance([NodeWrenches::NONE; 2]).is_err() {
                break;
            }
        }
    }
    if scene.task.is_some() || scene.control.is_some() {
        let _ = scene.optimal_control_until(&source, &until());
    }
    if scene.mpc.is_some() {
        let _ = scene.closed_loop(&source, 0, &until());
    }
    true
}

/// Four thousand scenes from the built-in ones, with up to three changes each at keys that they have and at all keys of the schema: they are
/// read, and their simulation, problem and loop are set up and begun, or refused. The sequence is the same in every run.
#[test]
fn odd_scenes_are_refused_or_computed() {
    let known = keys_of_schema();
    assert!(known.len() > 300, "{} keys", known.len());
    let scenes: Vec<Value> = (builtin::names())
        .map(|name| {
            let (scene, _) = Scene::load(name, &[]).expect("a built-in scene");
            let mut table: Table = toml::from_str(&scene.to_toml()).expect("TOML");
            // A few elements are enough to begin.
            if let Some(Value::Table(rod)) = table.get_mut("rod")
                && !rod.contains_key("segment")
            {
                rod.insert("elements".into(), Value::Integer(4));
            }
            Value::Table(table)
        })
        .collect();
    let (mut faults, mut n_read) = (Vec::new(), 0);
    for seed in 0..N_SCENES {
        let mut dice = fastrand::Rng::with_seed(seed);
        let mut scene = scenes[dice.usize(..scenes.len())].clone();
        for _ in 0..dice.usize(1..=3) {
            let mut own = Vec::new();
            places(&scene, &Vec::new(), &mut own);
            let place = own[dice.usize(..own.len())].clone();
            match dice.u32(0..8) {
                0 => change(&mut scene, &place, |parent, key| match parent {
                    Value::Table(table) => {
                        table.remove(key);
                    }
                    Value::Array(items) => {
                        if let Ok(i) = key.parse::<usize>()
                            && i < items.len()
                        {
                            items.remove(i);
                        }
                    }
                    _ => {}
                }),
                1..3 => {
                    let place = known[dice.usize(..known.len())].clone();
                    let value = odd(&mut dice, None);
                    put(&mut scene, &place, value);
                }
                _ => {
                    let dice = &mut dice;
                    change(&mut scene, &place, |parent, key| {
                        if let Some(value) = child(parent, key) {
                            *value = odd(dice, Some(value));
                        }
                    });
                }
            }
        }
        let text = toml::to_string(&scene).expect("TOML");
        match catch_unwind(AssertUnwindSafe(|| begin(&text))) {
            Ok(is_read) => n_read += usize::from(is_read),
            Err(_) => faults.push(format!("seed {seed}:\n{text}")),
        }
    }
    let part = n_read as f64 / N_SCENES as f64;
    assert!(part > LEAST_READ, "{part} of the scenes are read");
    assert!(
        faults.is_empty(),
        "{} scenes panic; the first is {}",
        faults.len(),
        faults[0]
    );
}
