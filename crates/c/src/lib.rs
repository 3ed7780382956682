//! The controller of softarm for programs in C and C++: the functions of `include/softarm.h`, which explains them.
//!
//! Everything behind this border is that of [`softarm::mpc::Server`]; here pointers become slices, errors codes, and panics a code too.

use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char, c_int};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use softarm::mechanics::rollout::{ControlRows, Rollout};
use softarm::mechanics::stability::automatic_step;
use softarm::mechanics::{Rod, State, TimeGrid, Wrench};
use softarm::mpc::{
    Command, ControlList, ControlledPart, Heard, MeasurementLine, Server, Transfer,
};
use softarm::nalgebra::Vector3;
use softarm::scene::{Scene, ServerError};
use softarm::stop::StopSignal;

/// A code and what went wrong.
struct Failure(c_int, String);

const OK: c_int = 0;
const REFUSED: c_int = 1;
const FALLBACK: c_int = 2;
const SCENE: c_int = -1;
const MODEL: c_int = -2;
const ARGUMENT: c_int = -3;
const FAULT: c_int = -4;

thread_local! {
    static TEXT: RefCell<CString> = RefCell::new(CString::default());
}

fn tell(text: &str) {
    let clean: Vec<u8> = text.bytes().filter(|byte| *byte != 0).collect();
    TEXT.with_borrow_mut(|own| *own = CString::new(clean).unwrap_or_default());
}

/// Runs a call, whose failure or panic becomes a code and a text.
fn call(work: impl FnOnce() -> Result<c_int, Failure>) -> c_int {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(code)) => code,
        Ok(Err(Failure(code, text))) => {
            tell(&text);
            code
        }
        Err(_) => {
            tell("a fault of softarm: please report it");
            FAULT
        }
    }
}

fn wrong(text: impl Into<String>) -> Failure {
    Failure(ARGUMENT, text.into())
}

/// A controller, behind a pointer of C.
pub struct Controller {
    /// The controller, and its answer to the last measurement where it was asked for as text.
    server: Mutex<(Server<Heard>, CString)>,
    model: Rod,
    /// The last two commands, which another thread may ask for.
    sent: Mutex<[Option<Command>; 2]>,
    controls: Arc<ControlList>,
    period: f64,
    first: f64,
    places: Vec<f64>,
    names: Vec<*const c_char>,
    units: Vec<*const c_char>,
    /// What the pointers point to, and the answer to the last measurement.
    _texts: Vec<CString>,
    hello: CString,
    plant: Arc<Rod>,
    initial: State,
}

/// A simulated arm, behind a pointer of C.
pub struct Plant {
    rod: Arc<Rod>,
    transfer: Transfer,
    state: State,
    time: f64,
    longest_step: f64,
    /// The controls, on the nodes of the plant.
    controls: ControlList,
    model: Rod,
}

/// See `softarm.h`.
#[repr(C)]
pub struct Description {
    period_s: f64,
    first_command_from_s: f64,
    n_nodes: usize,
    n_controls: usize,
    places: *const f64,
    names: *const *const c_char,
    units: *const *const c_char,
    hello: *const c_char,
}

/// See `softarm.h`.
#[repr(C)]
pub struct Measurement {
    time_s: f64,
    positions: *const f64,
    rotations: *const f64,
    velocities: *const f64,
    angular_velocities: *const f64,
    more: *const c_char,
}

/// Reads a text of C.
///
/// # Safety
/// The pointer is null, or ends with a zero.
unsafe fn text<'a>(name: &str, pointer: *const c_char) -> Result<&'a str, Failure> {
    if pointer.is_null() {
        return Err(wrong(format!("{name} is NULL")));
    }
    // SAFETY: the caller says so.
    unsafe { CStr::from_ptr(pointer) }
        .to_str()
        .map_err(|_| wrong(format!("{name} is no UTF-8")))
}

/// Reads `n` groups of numbers, if there are any.
///
/// # Safety
/// The pointer is null, or that of as many numbers.
unsafe fn groups<const N: usize>(pointer: *const f64, n: usize) -> Option<Vec<[f64; N]>> {
    if pointer.is_null() {
        return None;
    }
    // SAFETY: the caller says so; the alignment of arrays of numbers is that of numbers.
    Some(unsafe { std::slice::from_raw_parts(pointer.cast::<[f64; N]>(), n) }.to_vec())
}

/// Writes numbers, if they are asked for.
///
/// # Safety
/// The pointer is null, or that of room for as many numbers.
unsafe fn put(pointer: *mut f64, numbers: impl Iterator<Item = f64>) {
    if !pointer.is_null() {
        for (index, number) in numbers.enumerate() {
            // SAFETY: the caller says so.
            unsafe { pointer.add(index).write(number) };
        }
    }
}

/// Writes a state of a rod.
///
/// # Safety
/// As [`put`], of 3, 9, 3 and 3 numbers for every node.
unsafe fn put_state(rod: &Rod, state: &State, out: [*mut f64; 4]) {
    let shape = &state.configuration;
    let flat = |vectors: &[Vector3<f64>]| vectors.iter().flatten().copied().collect::<Vec<_>>();
    let [velocities, spins] = state.velocities(&rod.nodes);
    let rows =
        |m: &softarm::nalgebra::Matrix3<f64>| m.transpose().iter().copied().collect::<Vec<_>>();
    let turned: Vec<f64> = shape.rotations.iter().flat_map(rows).collect();
    // SAFETY: the caller says so.
    unsafe {
        put(out[0], flat(&shape.positions).into_iter());
        put(out[1], turned.into_iter());
        put(out[2], flat(&velocities).into_iter());
        put(out[3], flat(&spins).into_iter());
    }
}

impl Controller {
    fn make(name: &str, overrides: &[String]) -> Result<Self, Failure> {
        let scene_error = |error: softarm::scene::SceneError| Failure(SCENE, error.to_string());
        let (scene, source) = Scene::load(name, overrides).map_err(scene_error)?;
        let stop = StopSignal::default();
        let made = scene.server(&source, name, &stop);
        let (mut server, setup) = made.map_err(|error| match error {
            ServerError::Scene(error) => scene_error(error),
            ServerError::Serve(error) => Failure(MODEL, error.to_string()),
        })?;
        let hello = CString::new(std::mem::take(&mut server.peer().hello)).unwrap_or_default();
        let driver = server.driver();
        let controls = Arc::clone(&driver.controller().command().list);
        let texts: Vec<CString> = (controls.named())
            .flat_map(|own| [own.name.as_str(), own.unit])
            .map(|text| CString::new(text).unwrap_or_default())
            .collect();
        let pointers = |first: usize| texts[first..].iter().step_by(2).map(|own| own.as_ptr());
        Ok(Self {
            sent: Mutex::default(),
            period: driver.controller().settings().period,
            first: driver.settings().lead(),
            places: server.model().places(),
            model: server.model().clone(),
            names: pointers(0).collect(),
            units: pointers(1.min(texts.len())).collect(),
            _texts: texts,
            hello,
            plant: setup.plant,
            initial: setup.initial,
            controls,
            server: Mutex::new((server, CString::default())),
        })
    }

    fn sent(&self) -> MutexGuard<'_, [Option<Command>; 2]> {
        self.sent.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the values of all controls that act at a time.
    fn acting(&self, time: f64) -> Vec<f64> {
        let sent = self.sent();
        let begun = |own: &&Command| own.start <= time + 1e-9;
        match sent.iter().rev().flatten().find(begun) {
            None => self.controls.named().map(|own| own.rest).collect(),
            Some(command) => (0..self.controls.len())
                .map(command.commanded_at(time))
                .collect(),
        }
    }

    fn server(&self) -> MutexGuard<'_, (Server<Heard>, CString)> {
        self.server.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Answers a measurement; returns the code, and the pointer to the lines of the answer if they are asked for.
    fn step(
        &self,
        mut line: MeasurementLine,
        with_text: bool,
    ) -> Result<(c_int, *const c_char), Failure> {
        let (server, text) = &mut *self.server();
        if line.time_s.is_none_or(f64::is_nan) {
            line.time_s = Some(server.next_time());
        }
        let heard =
            (server.answer_line(line)).map_err(|error| Failure(FAULT, error.to_string()))?;
        let mut code = OK;
        let fallback = heard.command.as_ref().and_then(|own| own.fallback.as_ref());
        if let Some(own) = fallback {
            tell(&format!(
                "the command is that of the fall-back: {}, {}",
                own.cause, own.action
            ));
            code = FALLBACK;
        }
        if let Some(error) = heard.errors.last() {
            tell(&format!(
                "{}: {}; {}",
                error.place, error.message, error.help
            ));
            code = code.max(REFUSED);
        }
        if with_text {
            *text = CString::new(heard.lines()).unwrap_or_default();
        }
        let command = server.driver().told().clone();
        let mut sent = self.sent();
        let last = sent[1].take();
        *sent = [last, Some(command)];
        Ok((code, text.as_ptr()))
    }
}

impl Plant {
    fn of(controller: &Controller) -> Self {
        let rod = Arc::clone(&controller.plant);
        let model = controller.model.clone();
        let places = rod.places();
        let nearest = |place: f64| {
            let off = |q: &usize| (places[*q] - place).abs();
            (0..places.len())
                .min_by(|a, b| off(a).total_cmp(&off(b)))
                .unwrap_or(0)
        };
        let nodes: Vec<usize> = controller
            .places
            .iter()
            .map(|place| nearest(*place))
            .collect();
        Self {
            transfer: Transfer::new(&rod, &model),
            state: controller.initial.clone(),
            time: 0.0,
            longest_step: automatic_step(&rod),
            controls: (controller.controls).placed(|node| [(nodes[node], 1.0)]),
            rod,
            model,
        }
    }

    fn step(&mut self, controller: &Controller, dt: f64) -> Result<c_int, Failure> {
        if !(dt > 0.0 && dt <= 1e6 * self.longest_step) {
            let words = format!("dt_s = {dt}; expected a positive time of at most a million steps");
            return Err(wrong(words));
        }
        if controller.controls.len() != self.controls.len() {
            return Err(wrong("the controller is not the one of the plant"));
        }
        let nodes = self.controls.nodes();
        let mut rows = ControlRows {
            n_rows: 2,
            linear: true,
            nodes: nodes.to_vec(),
            ..ControlRows::default()
        };
        // Just before the end, where the next command may begin.
        for time in [self.time, self.time + dt * (1.0 - 1e-6)] {
            let mut efforts = self.rod.actuators.efforts(time);
            let mut wrenches = vec![Wrench::default(); nodes.len()];
            let values = controller.acting(time);
            self.controls.visit(
                |control| values[control],
                |on, amount| match on {
                    ControlledPart::Effort(actuator) => efforts[actuator] += amount,
                    ControlledPart::Node(node, component) => {
                        if let Some(at) = nodes.iter().position(|own| *own == node) {
                            wrenches[at][component] += amount;
                        }
                    }
                },
            );
            rows.inputs.extend(efforts);
            rows.wrenches.extend(wrenches);
        }
        let grid = TimeGrid::covering(dt, self.longest_step, 1);
        let stop = StopSignal::default();
        let rollout = Rollout {
            rod: &self.rod,
            start: self.time,
            step: grid.step,
            n_steps: grid.n_steps,
            controls: &rows,
            stop: &stop,
        };
        let states = rollout.states(&self.state);
        let mut states = states.map_err(|error| Failure(MODEL, error.to_string()))?;
        self.state = states.swap_remove(1);
        self.time += dt;
        Ok(OK)
    }
}

/// Borrows what a pointer of C points to.
///
/// # Safety
/// The pointer is null, or came from this library and was not freed.
unsafe fn borrowed<'a, T>(name: &str, pointer: *const T) -> Result<&'a T, Failure> {
    // SAFETY: the caller says so.
    unsafe { pointer.as_ref() }.ok_or_else(|| wrong(format!("{name} is NULL")))
}

/// See `softarm.h`.
///
/// # Safety
/// Pointers are those that `softarm.h` asks for.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn softarm_new(
    scene: *const c_char,
    overrides: *const *const c_char,
    n_overrides: usize,
    controller: *mut *mut Controller,
) -> c_int {
    call(|| {
        if controller.is_null() {
            return Err(wrong("controller is NULL"));
        }
        // SAFETY: the caller says so.
        unsafe { controller.write(std::ptr::null_mut()) };
        let mut setters = Vec::new();
        for index in 0..n_overrides {
            if overrides.is_null() {
                return Err(wrong("overrides is NULL"));
            }
            // SAFETY: the caller says so.
            setters.push(unsafe { text("an override", *overrides.add(index)) }?.to_string());
        }
        // SAFETY: the caller says so.
        let name = unsafe { text("scene", scene) }?;
        let made = Box::new(Controller::make(name, &setters)?);
        // SAFETY: the caller says so.
        unsafe { controller.write(Box::into_raw(made)) };
        Ok(OK)
    })
}

/// See `softarm.h`.
///
/// # Safety
/// As [`softarm_new`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn softarm_describe(
    controller: *const Controller,
    description: *mut Description,
) -> c_int {
    call(|| {
        // SAFETY: the caller says so.
        let own = unsafe { borrowed("controller", controller) }?;
        if description.is_null() {
            return Err(wrong("description is NULL"));
        }
        let made = Description {
            period_s: own.period,
            first_command_from_s: own.first,
            n_nodes: own.places.len(),
            n_controls: own.controls.len(),
            places: own.places.as_ptr(),
            names: own.names.as_ptr(),
            units: own.units.as_ptr(),
            hello: own.hello.as_ptr(),
        };
        // SAFETY: the caller says so.
        unsafe { description.write(made) };
        Ok(OK)
    })
}

/// See `softarm.h`.
///
/// # Safety
/// As [`softarm_new`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn softarm_step(
    controller: *mut Controller,
    measurement: *const Measurement,
    answer: *mut *const c_char,
) -> c_int {
    call(|| {
        // SAFETY: the caller says so.
        let (own, measured) = unsafe {
            (
                borrowed("controller", controller)?,
                borrowed("measurement", measurement)?,
            )
        };
        let mut fields = serde_json::Map::new();
        if !measured.more.is_null() {
            // SAFETY: the caller says so.
            let more = unsafe { text("more", measured.more) }?;
            fields = serde_json::from_str(more)
                .map_err(|error| wrong(format!("more is no JSON object: {error}")))?;
        }
        fields.insert("type".into(), "measurement".into());
        let mut line: MeasurementLine = serde_json::from_value(fields.into())
            .map_err(|error| wrong(format!("more: {error}")))?;
        let n = own.places.len();
        line.time_s = Some(measured.time_s);
        // SAFETY: the caller says so.
        unsafe {
            let rows = |m: [f64; 9]| [[m[0], m[1], m[2]], [m[3], m[4], m[5]], [m[6], m[7], m[8]]];
            line.positions_m = groups::<3>(measured.positions, n);
            line.rotations =
                groups::<9>(measured.rotations, n).map(|all| all.into_iter().map(rows).collect());
            line.velocities_m_s = groups::<3>(measured.velocities, n);
            line.angular_velocities_rad_s = groups::<3>(measured.angular_velocities, n);
        }
        let (code, lines) = own.step(line, !answer.is_null())?;
        if !answer.is_null() {
            // SAFETY: the caller says so.
            unsafe { answer.write(lines) };
        }
        Ok(code)
    })
}

/// See `softarm.h`.
///
/// # Safety
/// As [`softarm_new`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn softarm_acting(
    controller: *const Controller,
    time_s: f64,
    values: *mut f64,
) -> c_int {
    call(|| {
        if !time_s.is_finite() {
            return Err(wrong(format!("time_s = {time_s}; expected a finite time")));
        }
        // SAFETY: the caller says so.
        let own = unsafe { borrowed("controller", controller) }?;
        // SAFETY: the caller says so.
        unsafe { put(values, own.acting(time_s).into_iter()) };
        Ok(OK)
    })
}

/// See `softarm.h`.
///
/// # Safety
/// As [`softarm_new`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn softarm_state(
    controller: *const Controller,
    time_s: *mut f64,
    positions: *mut f64,
    rotations: *mut f64,
    velocities: *mut f64,
    angular_velocities: *mut f64,
) -> c_int {
    call(|| {
        // SAFETY: the caller says so.
        unsafe {
            let own = borrowed("controller", controller)?;
            let server = own.server();
            let driver = server.0.driver();
            put(time_s, std::iter::once(driver.known_at()));
            let out = [positions, rotations, velocities, angular_velocities];
            put_state(&own.model, driver.known(), out);
        }
        Ok(OK)
    })
}

/// See `softarm.h`.
///
/// # Safety
/// As [`softarm_new`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn softarm_free(controller: *mut Controller) {
    if !controller.is_null() {
        // SAFETY: the caller says so.
        drop(unsafe { Box::from_raw(controller) });
    }
}

/// See `softarm.h`.
///
/// # Safety
/// As [`softarm_new`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn softarm_plant_new(
    controller: *const Controller,
    plant: *mut *mut Plant,
) -> c_int {
    call(|| {
        // SAFETY: the caller says so.
        let own = unsafe { borrowed("controller", controller) }?;
        if plant.is_null() {
            return Err(wrong("plant is NULL"));
        }
        // SAFETY: the caller says so.
        unsafe { plant.write(Box::into_raw(Box::new(Plant::of(own)))) };
        Ok(OK)
    })
}

/// See `softarm.h`.
///
/// # Safety
/// As [`softarm_new`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn softarm_plant_step(
    plant: *mut Plant,
    controller: *const Controller,
    dt_s: f64,
) -> c_int {
    call(|| {
        // SAFETY: the caller says so.
        let (plant, controller) = unsafe {
            let own = plant.as_mut().ok_or_else(|| wrong("plant is NULL"))?;
            (own, borrowed("controller", controller)?)
        };
        plant.step(controller, dt_s)
    })
}

/// See `softarm.h`.
///
/// # Safety
/// As [`softarm_new`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn softarm_plant_state(
    plant: *const Plant,
    time_s: *mut f64,
    positions: *mut f64,
    rotations: *mut f64,
    velocities: *mut f64,
    angular_velocities: *mut f64,
) -> c_int {
    call(|| {
        // SAFETY: the caller says so.
        unsafe {
            let own = borrowed("plant", plant)?;
            put(time_s, std::iter::once(own.time));
            let out = [positions, rotations, velocities, angular_velocities];
            put_state(&own.model, &own.transfer.state(&own.state), out);
        }
        Ok(OK)
    })
}

/// See `softarm.h`.
///
/// # Safety
/// As [`softarm_new`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn softarm_plant_free(plant: *mut Plant) {
    if !plant.is_null() {
        // SAFETY: the caller says so.
        drop(unsafe { Box::from_raw(plant) });
    }
}

/// See `softarm.h`.
#[unsafe(no_mangle)]
pub extern "C" fn softarm_text() -> *const c_char {
    TEXT.with_borrow(|own| own.as_ptr())
}
