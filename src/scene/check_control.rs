//! Checks of what acts: bounds on wrenches, rates, and couples along the arm.

use super::check::LARGEST_COUNT;
use super::keys::{Checked, Keys};
use super::model::{BaseKind, Bound, Control, Distributed, Scene};

/// What to do where no part of a wrench acts.
const NAME_A_PART: &str = "a force or moment acts only where it is named; give its largest magnitude, or `inf` for no bound: \
force_max_n = inf";

impl Keys<'_> {
    pub(super) fn check_control(&self, control: &Control, scene: &Scene) -> Checked {
        self.count("control.blocks", control.blocks, LARGEST_COUNT)?;
        self.check_bounds(
            "control",
            [
                (control.force_max_n, control.force_axes),
                (control.moment_max_n_m, control.moment_axes),
            ],
        )?;
        for (key, bound, unit) in [
            (
                "control.force_rate_max_n_s",
                control.force_rate_max_n_s,
                "N/s",
            ),
            (
                "control.moment_rate_max_n_m_s",
                control.moment_rate_max_n_m_s,
                "N m/s",
            ),
        ] {
            match bound {
                None => {}
                Some(Bound::Norm(norm)) => self.positive(key, norm, "rate", unit)?,
                Some(Bound::PerAxis(bounds)) => {
                    for (axis, bound) in bounds.into_iter().enumerate() {
                        self.positive(&format!("{key}.{axis}"), bound, "rate", unit)?;
                    }
                }
            }
        }
        let acts =
            |parts: [Option<Bound>; 2]| parts.into_iter().flatten().any(|part| !part.is_zero());
        let mut nothing = !acts([control.force_max_n, control.moment_max_n_m]);
        let elements = scene.rod.elements;
        for (index, actuator) in control.actuator.iter().enumerate() {
            let key = format!("control.actuator.{index}");
            let held = scene.base.kind != BaseKind::Free && actuator.node == 0;
            let earlier = &control.actuator[..index];
            let message = if actuator.node > elements {
                format!("there is no node {}", actuator.node)
            } else if actuator.node == elements {
                "the tip has the control's own force and moment".to_string()
            } else if held {
                "a held or driven base does not answer to forces".to_string()
            } else if earlier.iter().any(|other| other.node == actuator.node) {
                format!("node {} is given twice", actuator.node)
            } else {
                self.check_bounds(
                    &key,
                    [
                        (actuator.force_max_n, actuator.force_axes),
                        (actuator.moment_max_n_m, actuator.moment_axes),
                    ],
                )?;
                let parts = [actuator.force_max_n, actuator.moment_max_n_m];
                if parts == [None; 2] {
                    return Err(self.source.error_at(
                        &key,
                        "names neither force_max_n nor moment_max_n_m, so that nothing acts on this node",
                        Some(NAME_A_PART.into()),
                    ));
                }
                nothing &= !acts(parts);
                continue;
            };
            return Err(self
                .source
                .error_at(&format!("{key}.node"), message, None)
                .expecting(format!(
                    "expected another node, below the tip's index {elements}"
                )));
        }
        if let Some(distributed) = &control.distributed {
            self.check_distributed(distributed, scene)?;
            nothing = false;
        }
        if nothing {
            let message = "force_max_n and moment_max_n_m are 0 or not named, so that there is nothing to control with";
            return Err((self.source).error_at("control", message, Some(NAME_A_PART.into())));
        }
        Ok(())
    }

    fn check_distributed(&self, distributed: &Distributed, scene: &Scene) -> Checked {
        const MOST_POINTS: usize = 100;
        self.count(
            "control.distributed.points",
            distributed.points,
            MOST_POINTS,
        )?;
        let key = "control.distributed.moment_max_n_m_per_m";
        let bounds = match distributed.moment_max_n_m_per_m {
            Bound::Norm(norm) => vec![(key.to_string(), norm)],
            Bound::PerAxis(bounds) => (0..3)
                .map(|axis| (format!("{key}.{axis}"), bounds[axis]))
                .collect(),
        };
        for (key, bound) in bounds {
            self.finite_number(&key, bound)?;
            self.not_below_zero(&key, bound, "bound", "N m/m")?;
        }
        let (key, message, help) = if distributed.moment_max_n_m_per_m.is_zero() {
            (key, "nothing acts", "leave [control.distributed] out")
        } else if scene.rod.elements < 2 {
            let message = "couples act on the nodes between the ends, and one element has none";
            (
                "control.distributed",
                message,
                "give rod.elements of 2 or more",
            )
        } else {
            return Ok(());
        };
        Err((self.source).error_at(key, message, Some(help.into())))
    }

    fn check_bounds(
        &self,
        section: &str,
        parts: [(Option<Bound>, Option<[bool; 3]>); 2],
    ) -> Checked {
        let names = [
            ("force_max_n", "force_axes", "N"),
            ("moment_max_n_m", "moment_axes", "N m"),
        ];
        for ((name, axes_name, unit), (bound, axes)) in names.into_iter().zip(parts) {
            let key = format!("{section}.{name}");
            match bound {
                None => {}
                Some(Bound::Norm(norm)) => self.not_below_zero(&key, norm, "bound", unit)?,
                Some(Bound::PerAxis(bounds)) => {
                    for (axis, bound) in bounds.into_iter().enumerate() {
                        self.not_below_zero(&format!("{key}.{axis}"), bound, "bound", unit)?;
                    }
                }
            }
            let message = match axes {
                Some(_) if bound.is_none() => {
                    format!("there is no {name} that could act along them")
                }
                Some([false, false, false]) => "nothing acts along no axis".into(),
                _ => continue,
            };
            let help = format!("leave {axes_name} out, or {name} where nothing is to act");
            let key = format!("{section}.{axes_name}");
            return Err((self.source).error_at(&key, message, Some(help)));
        }
        Ok(())
    }
}
