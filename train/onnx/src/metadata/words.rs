//! The words of a description: what the output means, how the input is coded, how weights are stored.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// What the numbers in a model's output are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OutputMeaning {
    /// Disparity as a fraction of the image width.
    DisparityFraction,
    /// Disparity in pixels of the network's input.
    DisparityPx,
    /// Inverse depth up to an unknown scale.
    InverseDepth,
    /// Inverse depth in 1/m.
    InverseDepthPerM,
    /// Depth up to an unknown scale and, for many models, an unknown shift.
    Depth,
    /// Depth in metres.
    DepthM,
}

impl OutputMeaning {
    /// Every meaning, in the order of the documentation.
    pub const ALL: [Self; 6] = [
        Self::DisparityFraction,
        Self::DisparityPx,
        Self::InverseDepth,
        Self::InverseDepthPerM,
        Self::Depth,
        Self::DepthM,
    ];

    /// Whether depth in metres follows from the numbers, given a camera where they are disparity.
    #[must_use]
    pub const fn has_scale(self) -> bool {
        !matches!(self, Self::InverseDepth | Self::Depth)
    }

    /// The word used in files.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::DisparityFraction => "disparity_fraction",
            Self::DisparityPx => "disparity_px",
            Self::InverseDepth => "inverse_depth",
            Self::InverseDepthPerM => "inverse_depth_per_m",
            Self::Depth => "depth",
            Self::DepthM => "depth_m",
        }
    }
}

/// The interval that the colour values of the input cover.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum InputRange {
    /// 8-bit values divided by 255.
    #[serde(rename = "0..1")]
    Unit,
    /// 8-bit values as they are.
    #[serde(rename = "0..255")]
    Bytes,
}

impl InputRange {
    /// The text used in files.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Unit => "0..1",
            Self::Bytes => "0..255",
        }
    }
}

/// How a file stores the weights of its convolutions; everything is computed in `f32`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Weights {
    /// As they were trained.
    #[default]
    F32,
    /// Rounded to half precision, half the size.
    F16,
}

impl Weights {
    /// The text used in files.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F16 => "f16",
        }
    }
}

macro_rules! text_enum {
    ($name:ident, $what:literal, [$($value:expr),+]) => {
        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(self.as_str())
            }
        }

        impl FromStr for $name {
            type Err = String;

            fn from_str(text: &str) -> Result<Self, String> {
                let known = [$($value),+];
                known.into_iter().find(|value| value.as_str() == text).ok_or_else(|| {
                    let known: Vec<&str> = known.iter().map(|value| value.as_str()).collect();
                    format!("\"{text}\" is not a known {}; known are {}", $what, known.join(", "))
                })
            }
        }
    };
}

text_enum!(
    OutputMeaning,
    "output meaning",
    [
        OutputMeaning::DisparityFraction,
        OutputMeaning::DisparityPx,
        OutputMeaning::InverseDepth,
        OutputMeaning::InverseDepthPerM,
        OutputMeaning::Depth,
        OutputMeaning::DepthM
    ]
);
text_enum!(Weights, "kind of weights", [Weights::F32, Weights::F16]);
text_enum!(
    InputRange,
    "input range",
    [InputRange::Unit, InputRange::Bytes]
);
