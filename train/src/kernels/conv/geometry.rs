//! The sizes of a convolution.

use super::images::Images;
use super::pieces::Source;
use super::windows::Layout;

/// A convolution of a batch. Images are channels, height and width.
#[derive(Clone, Copy, Debug)]
pub(super) struct Geometry {
    pub batch: usize,
    pub large: [usize; 3],
    pub small: [usize; 3],
    pub kernel: usize,
    pub stride: usize,
    pub padding: usize,
}

impl Geometry {
    /// The windows of the convolution, on the large image.
    pub fn source<'a>(&self, large: Images<'a>) -> Source<'a> {
        let Self {
            kernel,
            stride,
            padding,
            ..
        } = *self;
        Source {
            images: large,
            size: self.large,
            layout: (!self.is_pointwise()).then_some(Layout {
                size: kernel,
                stride,
                before: padding,
                columns: self.small[2],
            }),
        }
    }

    /// Row and column of all places of a window.
    pub fn places(&self) -> Vec<[usize; 2]> {
        (0..self.kernel)
            .flat_map(|y| (0..self.kernel).map(move |x| [y, x]))
            .collect()
    }

    pub fn is_pointwise(&self) -> bool {
        self.kernel == 1 && self.stride == 1 && self.padding == 0
    }
}
