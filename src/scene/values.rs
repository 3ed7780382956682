//! Numbers that check themselves, and defaults of keys.

pub use values::*;

/// Returns true, the default of some keys.
pub(super) fn yes() -> bool {
    true
}

/// Tells whether a key is as it is without being given.
pub(super) fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// Writes the key of a choice that may be left to the program: the words of a type of the library, and "auto" for `None`.
macro_rules! or_auto {
    (
        $(#[$about:meta])*
        $Key:ident($name:literal) of $Own:ty { $(#[$about_auto:meta])* Auto, $($(#[$about_word:meta])* $Word:ident: $own:ident,)* }
    ) => {
        $(#[$about])*
        #[derive(serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
        #[schemars(rename = $name)]
        #[serde(rename_all = "kebab-case")]
        enum $Key {
            $(#[$about_auto])*
            Auto,
            $($(#[$about_word])* $Word,)*
        }

        impl $crate::scene::values::Written<Option<$Own>> for $Key {
            fn of(plain: &Option<$Own>) -> Self {
                match plain {
                    None => Self::Auto,
                    $(Some(<$Own>::$own) => Self::$Word,)*
                }
            }

            fn plain(self) -> Option<$Own> {
                match self {
                    Self::Auto => None,
                    $(Self::$Word => Some(<$Own>::$own),)*
                }
            }
        }
    };
}
pub(super) use or_auto;
