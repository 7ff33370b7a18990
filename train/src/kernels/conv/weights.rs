//! The gradient of a convolution with respect to its weights.

use rayon::prelude::*;

use super::super::product::multiply;
use super::geometry::Geometry;
use super::images::Images;
use super::pieces::{FEWEST_CHANNELS, FEWEST_POSITIONS, MOST_POSITIONS, PIECES, with_kept};
use super::windows::{Rows, Turned, Windows};

/// Most elements of all partial sums.
const PART_ELEMENTS: usize = 1 << 23;
/// Elements that are added up at a time.
const CHUNK: usize = 1 << 14;

impl Geometry {
    /// The gradient with respect to the weights, from the large and the small image; one of them is an
    /// input, the other the gradient of an output.
    pub fn weight_gradient(&self, large: Images, small: &[f32]) -> Vec<f32> {
        let window = self.large[0] * self.kernel * self.kernel;
        let [channels, height, width] = self.small;
        let positions = self.batch * height * width;
        let most = (PART_ELEMENTS / (channels * window).max(1)).min(PIECES);
        // Either the small image is turned, and at the end the result, or all windows are.
        let by_parts = positions * channels + channels * window < positions * window;
        if by_parts && most >= PIECES / 2 {
            self.weight_gradient_by_parts(large, small, most)
        } else {
            self.weight_gradient_by_channels(large, small)
        }
    }

    /// Each piece of work takes some of the positions; sums of windows times channels.
    fn weight_gradient_by_parts(&self, large: Images, small: &[f32], most: usize) -> Vec<f32> {
        let [channels, height, width] = self.small;
        let window = self.large[0] * self.kernel * self.kernel;
        let positions = self.batch * height * width;
        let wanted = (positions / most).clamp(FEWEST_POSITIONS, MOST_POSITIONS);
        let tiles = Rows::divide(self.batch, [height, width], wanted);
        let parts = most.min(tiles.len()).max(1);
        let (source, places) = (self.source(large), [self.places()]);
        let size = channels * window;
        with_kept(parts * size, |sums| {
            let partial = sums.par_chunks_exact_mut(size.max(1)).enumerate();
            partial.for_each(|(part, sum)| {
                sum.fill(0.0);
                for &rows in &tiles[part * tiles.len() / parts..(part + 1) * tiles.len() / parts] {
                    let planes = Windows::planes(small, self.small, rows, 0..channels);
                    let planes = Turned(&planes);
                    let depth = rows.positions(width);
                    let (rows_of, columns) = (0..window, 0..channels);
                    source.with_windows(rows, 0..self.large[0], &places, |windows| {
                        multiply(
                            &windows[0],
                            &planes,
                            rows_of,
                            columns,
                            depth,
                            |row, values| {
                                let line = &mut sum[row * channels..(row + 1) * channels];
                                for (sum, value) in line.iter_mut().zip(values) {
                                    *sum += *value;
                                }
                            },
                        );
                    });
                }
            });
            let (total, rest) = sums.split_at_mut(size);
            let chunks = total.par_chunks_mut(CHUNK).enumerate();
            chunks.for_each(|(chunk, total)| {
                for part in rest.chunks_exact(size.max(1)) {
                    for (sum, value) in total.iter_mut().zip(&part[chunk * CHUNK..]) {
                        *sum += value;
                    }
                }
            });
            turned(total, [window, channels])
        })
    }

    /// Each piece of work takes some channels of the large image; sums of channels times windows.
    fn weight_gradient_by_channels(&self, large: Images, small: &[f32]) -> Vec<f32> {
        let ([inputs, ..], [channels, height, width]) = (self.large, self.small);
        let area = self.kernel * self.kernel;
        let fewest = FEWEST_CHANNELS.div_ceil(area);
        let together = inputs.div_ceil(PIECES).max(fewest).max(1);
        let blocks = inputs.div_ceil(together);
        let mut gradient = vec![0.0_f32; channels * inputs * area];
        let mut out: Vec<Vec<&mut [f32]>> = (0..blocks).map(|_| Vec::new()).collect();
        for row in gradient.chunks_exact_mut((inputs * area).max(1)) {
            let parts = row.chunks_mut(together * area);
            out.iter_mut()
                .zip(parts)
                .for_each(|(out, part)| out.push(part));
        }
        let tiles = Rows::divide(self.batch, [height, width], MOST_POSITIONS);
        let (source, places) = (self.source(large), [self.places()]);
        out.into_par_iter()
            .enumerate()
            .for_each(|(block, mut out)| {
                let own = block * together..((block + 1) * together).min(inputs);
                let columns = own.len() * area;
                for (number, &rows) in tiles.iter().enumerate() {
                    let planes = Windows::planes(small, self.small, rows, 0..channels);
                    let depth = rows.positions(width);
                    source.with_windows(rows, own.clone(), &places, |windows| {
                        let windows = Turned(&windows[0]);
                        multiply(
                            &planes,
                            &windows,
                            0..channels,
                            0..columns,
                            depth,
                            |row, values| {
                                if number == 0 {
                                    out[row].copy_from_slice(values);
                                    return;
                                }
                                for (sum, value) in out[row].iter_mut().zip(values) {
                                    *sum += *value;
                                }
                            },
                        );
                    });
                }
            });
        gradient
    }
}

/// A matrix of `rows` and `columns` with the two exchanged.
fn turned(values: &[f32], [rows, columns]: [usize; 2]) -> Vec<f32> {
    const SIDE: usize = 16;
    let mut out = vec![0.0_f32; values.len()];
    out.par_chunks_mut((SIDE * rows).max(1))
        .enumerate()
        .for_each(|(block, out)| {
            let first = block * SIDE;
            let count = SIDE.min(columns - first);
            for (begin, lines) in (0..rows).step_by(SIDE).zip(values.chunks(SIDE * columns)) {
                for (row, line) in lines.chunks_exact(columns).enumerate() {
                    let line = &line[first..first + count];
                    for (&value, out) in
                        line.iter().zip(out[begin + row..].iter_mut().step_by(rows))
                    {
                        *out = value;
                    }
                }
            }
        });
    out
}
