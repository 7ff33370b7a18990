//! One image in several tensors whose channels follow each other, so that skip connections are read and
//! written where they lie. Nothing here computes.

/// Images whose channels follow each other: the numbers and the channels of each.
#[derive(Clone, Copy)]
pub(super) struct Images<'a>(pub &'a [(&'a [f32], usize)]);

impl<'a> Images<'a> {
    /// The plane of a sample and a channel; planes have `size` numbers.
    pub fn plane(&self, sample: usize, channel: usize, size: usize) -> &'a [f32] {
        let mut channel = channel;
        for &(values, channels) in self.0 {
            if channel < channels {
                return &values[(sample * channels + channel) * size..][..size];
            }
            channel -= channels;
        }
        unreachable!("a channel of the convolution is one of its images'")
    }
}

/// Planes of images `[n, c, h, w]`, of which there may be several whose channels follow each other,
/// sample by sample.
pub(super) fn planes<'a>(
    images: &'a mut [Vec<f32>],
    batch: usize,
    channels: &'a [usize],
    size: usize,
) -> impl Iterator<Item = &'a mut [f32]> {
    let mut images: Vec<_> = images
        .iter_mut()
        .map(|image| image.chunks_mut(size.max(1)))
        .collect();
    let order = (0..batch).flat_map(move |_| {
        let image = channels.iter().enumerate();
        image.flat_map(|(image, &channels)| std::iter::repeat_n(image, channels))
    });
    order.filter_map(move |image| images[image].next())
}
