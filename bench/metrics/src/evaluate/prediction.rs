//! What a model or a file says of an image, in the forms that can be scored.

/// A prediction at the size of the ground truth, row-major.
///
/// Under a protocol with KITTI's benchmark crop only its pixels are looked at; what stands elsewhere
/// must be a number and is irrelevant.
#[derive(Clone, Copy, Debug)]
pub enum Prediction<'a> {
    /// Disparity as a fraction of image width. The floor of the protocol applies, except where inverse
    /// depth is aligned: then disparity is inverse depth in some unit.
    DisparityFraction(&'a [f32]),
    /// Depth in metres: for models that do not predict disparity, and for baselines such as a
    /// constant map. The floor of the protocol does not apply. A depth of 0 is none, as in KITTI's own
    /// files: such pixels are left out of all figures and counted in
    /// [`ImageScore::floored_pixels`](crate::ImageScore::floored_pixels).
    DepthM(&'a [f32]),
    /// Inverse depth in no unit, of any sign, for protocols that align inverse depth. For median
    /// scaling it is given as disparity, at any scale.
    InverseDepth(&'a [f32]),
    /// Depth in no unit, of any sign, for protocols that align depth. 0 is a value like any other.
    Depth(&'a [f32]),
}
