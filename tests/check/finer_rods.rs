//! Steps of replays on finer rods.

use softarm::mechanics::stability::bent_step;
use softarm::mechanics::{
    Material, Rod, RodParameters, RotaryInertia, Section, SectionProfile, TimeScheme,
};
use softarm::verify::refinement::stable_factor;

/// A wire bent as far as its step allows: the finer rod's step allows it as well. With the inertia of sections a quarter of the step
/// suffices for a quarter of the length, with that of segments an eighth.
#[test]
fn finer_rods_are_replayed_with_stable_steps() {
    let steel = Material::isotropic(200e9, 0.3, 7850.0);
    let section = SectionProfile::Uniform(Section::circle(&steel, 0.5e-3));
    for (inertia, expected) in [(RotaryInertia::Section, 4), (RotaryInertia::Segment, 8)] {
        let rod = |elements: usize| {
            Rod::new(&RodParameters {
                scheme: TimeScheme::Implicit,
                rotary_inertia: inertia,
                ..RodParameters::straight(0.3, elements, section.clone())
            })
            .expect("a rod")
        };
        let (own, finer) = (rod(10), rod(40));
        let step = bent_step(&own);
        let factor = stable_factor(step, &own, &finer, 4);
        assert_eq!(factor, expected, "{inertia:?}");
        assert!(step / factor as f64 <= bent_step(&finer) * (1.0 + 1e-3));
    }
}
