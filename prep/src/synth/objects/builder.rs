//! Collects the shapes that the objects of one frame are made of.

use crate::synth::geometry::shapes::{Form, Material, Plane, Shape, Skin};
use crate::synth::vector::{Rgb, V3, dim, v3};

/// A position on the ground with a heading.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placement {
    pub at: V3,
    pub cos: f32,
    pub sin: f32,
}

impl Placement {
    /// A place given in this one's frame, heading turned by a quarter times `quarters`.
    pub fn offset(self, by: V3, quarters: u32) -> Placement {
        let at = self.at + by.turned(self.cos, self.sin);
        let (cos, sin) = match quarters % 4 {
            0 => (self.cos, self.sin),
            1 => (-self.sin, self.cos),
            2 => (-self.cos, -self.sin),
            _ => (self.sin, -self.cos),
        };
        Placement { at, cos, sin }
    }
}

/// Collects the shapes of one frame.
#[derive(Default)]
pub(crate) struct Builder {
    pub shapes: Vec<Shape>,
    pub planes: Vec<Plane>,
    /// Footprints of vehicles, for the shade under them.
    pub footprints: Vec<Footprint>,
    objects: u16,
}

/// A rectangle on the ground that something stands closely above.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Footprint {
    pub at: V3,
    pub cos: f32,
    pub sin: f32,
    pub half_length: f32,
    pub half_width: f32,
}

/// A skin with one colour.
pub(crate) fn skin(material: Material, paint: Rgb, seed: u32) -> Skin {
    Skin {
        material,
        paint,
        trim: dim(paint, 0.5),
        sizes: [0.0; 4],
        seed,
    }
}

impl Builder {
    /// Number for the next counted object.
    pub fn next_object(&mut self) -> u16 {
        self.objects = if self.objects >= 255 {
            255
        } else {
            self.objects + 1
        };
        self.objects
    }

    fn push(&mut self, place: Placement, low: V3, high: V3, form: Form, skin: Skin, tag: Tag) {
        self.shapes.push(Shape {
            centre: place.at,
            cos: place.cos,
            sin: place.sin,
            low,
            high,
            form,
            skin,
            label: tag.0,
            object: tag.1,
        });
    }

    /// A block between two corners of the place's frame.
    pub fn block(&mut self, place: Placement, low: V3, high: V3, skin: Skin, tag: Tag) {
        self.push(place, low, high, Form::Block, skin, tag);
    }

    /// An ellipsoid around a point of the place's frame.
    pub fn ellipsoid(&mut self, place: Placement, centre: V3, radii: V3, skin: Skin, tag: Tag) {
        let inverse = v3(1.0 / radii.x, 1.0 / radii.y, 1.0 / radii.z);
        self.push(
            place.offset(centre, 0),
            -radii,
            radii,
            Form::Ellipsoid { inverse },
            skin,
            tag,
        );
    }

    /// An upright cylinder.
    pub fn pillar(
        &mut self,
        place: Placement,
        foot: V3,
        radius: f32,
        height: f32,
        skin: Skin,
        tag: Tag,
    ) {
        self.push(
            place.offset(foot, 0),
            v3(-radius, -radius, 0.0),
            v3(radius, radius, height),
            Form::Pillar,
            skin,
            tag,
        );
    }

    /// A lying cylinder across the place's heading.
    pub fn drum(
        &mut self,
        place: Placement,
        centre: V3,
        size: (f32, f32, f32),
        skin: Skin,
        tag: Tag,
    ) {
        let (radius, inner, half) = size;
        self.push(
            place.offset(centre, 0),
            v3(-radius, -half, -radius),
            v3(radius, half, radius),
            Form::Drum { inner },
            skin,
            tag,
        );
    }

    /// A rounded rod between two points of the place's frame.
    pub fn rod(&mut self, place: Placement, from: V3, to: V3, radius: f32, skin: Skin, tag: Tag) {
        let r = v3(radius, radius, radius);
        self.push(
            place,
            from.min(to) - r,
            from.max(to) + r,
            Form::Rod { from, to, radius },
            skin,
            tag,
        );
    }

    /// A body with the convex side view `profile` (x, z; anticlockwise seen from the
    /// right, i.e. from -y) whose half width shrinks from `wide.0` at z = `wide.1`
    /// by `wide.2` per metre of height.
    pub fn hull(
        &mut self,
        place: Placement,
        profile: &[(f32, f32)],
        wide: (f32, f32, f32),
        skin: Skin,
        tag: Tag,
    ) {
        let first = self.planes.len() as u32;
        let (mut low, mut high) = (v3(1e9, 0.0, 1e9), v3(-1e9, 0.0, -1e9));
        for (i, &(x, z)) in profile.iter().enumerate() {
            let (nx, nz) = profile[(i + 1) % profile.len()];
            let normal = v3(nz - z, 0.0, x - nx).unit();
            self.planes.push(Plane {
                normal,
                offset: normal.x * x + normal.z * z,
            });
            low = low.min(v3(x, 0.0, z));
            high = high.max(v3(x, 0.0, z));
        }
        let (half, at, shrink) = wide;
        for side in [1.0, -1.0] {
            let normal = v3(0.0, side, shrink).unit();
            self.planes.push(Plane {
                normal,
                offset: (half + shrink * at) * normal.y.abs(),
            });
        }
        let reach = half + (shrink * (at - low.z)).max(0.0) + (shrink * (at - high.z)).max(0.0);
        low.y = -reach;
        high.y = reach;
        let count = self.planes.len() as u32 - first;
        self.push(place, low, high, Form::Convex { first, count }, skin, tag);
    }

    pub fn shade(&mut self, place: Placement, half_length: f32, half_width: f32) {
        self.footprints.push(Footprint {
            at: place.at,
            cos: place.cos,
            sin: place.sin,
            half_length,
            half_width,
        });
    }
}

/// Label and object number.
pub(crate) type Tag = (u8, u16);
