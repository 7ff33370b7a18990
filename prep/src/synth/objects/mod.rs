//! How cars, people, plants, houses and street furniture are put together from
//! [`super::geometry::shapes`], each with its Cityscapes label.
//!
//! Not here: where they stand (`world`) and what their surfaces look like (`shading`).

pub(crate) mod builder;
pub(crate) mod buildings;
pub(crate) mod furniture;
pub(crate) mod label;
mod paint;
pub(crate) mod people;
pub(crate) mod plants;
pub(crate) mod vehicles;
