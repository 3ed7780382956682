//! The native half of the Python package, `softarm._softarm`; its other half, which users see, is `python/softarm`.
//!
//! A scene crosses the border as text with overrides, a verb as the words of its command line, and its result as a directory, so that a verb
//! does from Python the same as from a terminal. Plants and controllers keep their state here and exchange arrays.

#![forbid(unsafe_code)]

mod arrays;
mod controller;
mod plant;
mod program;
mod rollout;
mod shapes;
mod words;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::thread;
use std::time::Duration;

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyList};

use words::in_python;

use softarm::cli::{CallError, Caller, Told};
use softarm::scene::{Scene, SceneError, SceneSource, builtin};
use softarm::stop::StopSignal;

/// Longest time between two looks at the signals of Python.
const GLANCE: Duration = Duration::from_millis(50);
/// Stack of a verb's thread: that of a main thread on Linux, which a verb has on the command line.
const STACK: usize = 8 << 20;

/// The module `softarm._softarm`.
#[pymodule]
mod _softarm {
    #[pymodule_export]
    use super::controller::Controller;
    #[pymodule_export]
    use super::plant::{Batch, Plant};
    #[pymodule_export]
    use super::program::Program;
    #[pymodule_export]
    use super::rollout::{Motions, Rollout};
    #[pymodule_export]
    use super::shapes::{inputs, shapes};
    #[pymodule_export]
    use super::{builtin_scenes, call, main, parse, schema};

    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}

/// Returns an exception of `softarm.errors`.
fn raise(py: Python<'_>, class: &str, words: String) -> PyErr {
    let made = (py.import("softarm.errors"))
        .and_then(|errors| errors.getattr(class))
        .and_then(|class| class.call1((words,)));
    made.map_or_else(|error| error, PyErr::from_value)
}

/// Returns the `SceneError` of Python, with key, line and help as attributes, and as `nearest` the nearest place that can be held, a
/// dictionary of `position_m` and `distance_m`, or None.
fn scene_error(py: Python<'_>, error: &SceneError) -> PyErr {
    let made = (py.import("softarm.errors"))
        .and_then(|errors| errors.getattr("SceneError"))
        .and_then(|class| {
            let words = error.to_string();
            let words = words.strip_prefix("error: ").unwrap_or(&words);
            let help = error.help().map(in_python);
            let made = class.call1((in_python(words), error.key(), error.line(), help))?;
            let nearest = error.nearest().map(|own| {
                let found = PyDict::new(py);
                found.set_item("position_m", own.position)?;
                found.set_item("distance_m", own.distance)?;
                Ok::<_, PyErr>(found)
            });
            made.setattr("nearest", nearest.transpose()?)?;
            Ok(made)
        });
    made.map_or_else(|error| error, PyErr::from_value)
}

fn call_error(py: Python<'_>, error: &CallError) -> PyErr {
    match error {
        CallError::Scene(error) => scene_error(py, error),
        CallError::Usage(words) => PyValueError::new_err(in_python(words)),
        CallError::Stopped(words) => raise(py, "Stopped", in_python(words)),
        CallError::Files(words) => raise(py, "ResultError", in_python(words)),
        CallError::Numerical(words) => raise(py, "ModelError", in_python(words)),
        CallError::Fault(words) => raise(py, "InternalError", words.clone()),
    }
}

/// Runs work on a thread of its own without the lock of the interpreter, and looks at the signals of Python meanwhile: at an interrupt, or
/// where `hears` raises, the work is asked to stop, its end is awaited, and the exception returned beside what it made.
///
/// # Errors
/// Returns `InternalError` if the work panics.
fn beside<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(mpsc::Sender<Told>, Arc<AtomicBool>) -> T + Send + 'static,
    hears: &mut dyn FnMut(Told) -> PyResult<()>,
) -> PyResult<(T, Option<PyErr>)> {
    let interrupted = Arc::new(AtomicBool::new(false));
    let (told, lines) = mpsc::channel();
    let lines = Mutex::new(lines);
    let flag = Arc::clone(&interrupted);
    let worker = thread::Builder::new()
        .name("softarm".into())
        .stack_size(STACK)
        .spawn(move || work(told, flag))
        .map_err(|error| raise(py, "InternalError", format!("no thread: {error}")))?;
    let mut raised = None;
    loop {
        let line = py.detach(|| {
            let lines = lines.lock().unwrap_or_else(PoisonError::into_inner);
            lines.recv_timeout(GLANCE)
        });
        let mut seen = py.check_signals();
        match line {
            Ok(told) if seen.is_ok() && raised.is_none() => seen = hears(told),
            Err(mpsc::RecvTimeoutError::Disconnected) => break,
            _ => {}
        }
        if let Err(error) = seen {
            interrupted.store(true, Ordering::SeqCst);
            raised.get_or_insert(error);
        }
    }
    match py.detach(|| worker.join()) {
        Ok(made) => Ok((made, raised)),
        Err(panic) => {
            let words = softarm::cli::panic_words(&*panic);
            let words = format!("{words}; this is a fault of softarm, please report it");
            Err(raise(py, "InternalError", words))
        }
    }
}

/// Runs a verb: the words of its command line after the name of the program, with the scene as name and text, or as the argument names it.
/// `hears` is called with the kind of a line ("message", "warning", "reason" or "data") and the line. Returns the exit code.
#[pyfunction]
#[pyo3(signature = (words, scene=None, hears=None))]
fn call(
    py: Python<'_>,
    words: Vec<String>,
    scene: Option<(String, String)>,
    hears: Option<Py<PyAny>>,
) -> PyResult<u8> {
    let work = move |told: mpsc::Sender<Told>, interrupted| {
        let caller = Caller {
            scene,
            interrupted,
            hears: Box::new(move |line| {
                // The listener may have gone.
                let _ = told.send(line);
            }),
        };
        softarm::cli::call(&words, caller)
    };
    let mut tell = |told: Told| match &hears {
        None => Ok(()),
        Some(hears) => {
            let (kind, line) = match told {
                Told::Message(line) => ("message", in_python(&line)),
                Told::Warning(line) => ("warning", in_python(&line)),
                Told::Reason(line) => ("reason", in_python(&line)),
                Told::Data(line) => ("data", line),
            };
            hears.call1(py, (kind, line)).map(|_| ())
        }
    };
    let (outcome, raised) = beside(py, work, &mut tell)?;
    match raised {
        Some(error) => Err(error),
        None => outcome.map_err(|error| call_error(py, &error)),
    }
}

/// Runs work that tells nothing as [`beside`] does, and raises what it fails with.
fn interruptibly<T: Send + 'static, E: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(StopSignal) -> Result<T, E> + Send + 'static,
    failed: impl FnOnce(E) -> PyErr,
) -> PyResult<T> {
    let work = move |_, interrupted| work(StopSignal::new(None, Some(interrupted)));
    match beside(py, work, &mut |_| Ok(()))? {
        (_, Some(raised)) => Err(raised),
        (found, None) => found.map_err(failed),
    }
}

/// Returns the number of threads that was asked for, or that of the cores.
fn n_threads(asked: Option<usize>) -> usize {
    let cores = || thread::available_parallelism().map_or(1, usize::from);
    asked.unwrap_or_else(cores).max(1)
}

/// Runs the command line `softarm` with the given words, the name of the program first, and returns its exit code.
#[pyfunction]
fn main(py: Python<'_>, words: Vec<String>) -> u8 {
    py.detach(|| softarm::cli::run_with(words.into_iter().map(Into::into)))
}

/// Reads a scene, from its text or, without one, from the file or built-in scene of the name.
fn read(
    py: Python<'_>,
    name: &str,
    text: Option<&str>,
    overrides: &[String],
) -> PyResult<(Scene, SceneSource)> {
    let read = match text {
        Some(text) => Scene::from_toml(name, text, overrides),
        None => Scene::load(name, overrides),
    };
    read.map_err(|error| scene_error(py, &error))
}

/// Returns the text of a scene as it was read, and the scene with every default as a dictionary.
#[pyfunction]
#[pyo3(signature = (name, text=None, overrides=Vec::new()))]
fn parse<'py>(
    py: Python<'py>,
    name: &str,
    text: Option<&str>,
    overrides: Vec<String>,
) -> PyResult<(String, Bound<'py, PyAny>)> {
    let (scene, source) = read(py, name, text, &overrides)?;
    let table: toml::Table = toml::from_str(&scene.to_toml())
        .map_err(|error| raise(py, "InternalError", error.to_string()))?;
    Ok((source.text, python(py, &toml::Value::Table(table))?))
}

/// Returns a value of TOML as one of Python; unlike JSON, both know infinite numbers.
fn python<'py>(py: Python<'py>, value: &toml::Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        toml::Value::String(text) => text.into_pyobject(py)?.into_any(),
        toml::Value::Integer(number) => number.into_pyobject(py)?.into_any(),
        toml::Value::Float(number) => number.into_pyobject(py)?.into_any(),
        toml::Value::Boolean(truth) => PyBool::new(py, *truth).to_owned().into_any(),
        toml::Value::Datetime(time) => time.to_string().into_pyobject(py)?.into_any(),
        toml::Value::Array(items) => {
            let items = items.iter().map(|item| python(py, item));
            PyList::new(py, items.collect::<PyResult<Vec<_>>>()?)?.into_any()
        }
        toml::Value::Table(table) => {
            let dict = PyDict::new(py);
            for (key, item) in table {
                dict.set_item(key, python(py, item)?)?;
            }
            dict.into_any()
        }
    })
}

/// Returns the names of the built-in scenes.
#[pyfunction]
fn builtin_scenes() -> Vec<&'static str> {
    builtin::names().collect()
}

/// Returns the JSON Schema of the scene file.
#[pyfunction]
fn schema() -> String {
    Scene::schema().to_string()
}
