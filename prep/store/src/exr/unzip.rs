//! Blocks of one 32-bit channel that OpenEXR's ZIP methods have packed, straight to values.
//!
//! Ground truth is decoded more often than anything else. The decoder for every kind of file goes over a
//! block five times after inflating it; for the one kind that `prep` writes two are enough. What is stored: the
//! bytes of even places, then those of odd places, each as the difference to the one before, plus 128, and all
//! that deflated. Not here: any other kind of block, which [`exr`] decodes.

use exr::block::chunk::{Chunk, CompressedBlock};
use exr::compression::Compression;
use exr::math::Vec2;
use exr::meta::BlockDescription;
use exr::meta::attribute::SampleType;
use exr::meta::header::Header;

use crate::raster::from_little_endian;

/// Whether the blocks of a layer are of this kind.
pub(super) fn is_packed(header: &Header) -> bool {
    matches!(header.compression, Compression::ZIP16 | Compression::ZIP1)
        && header.blocks == BlockDescription::ScanLines
        && matches!(header.channels.list.as_slice(), [only] if only.sample_type == SampleType::F32)
}

/// Puts the values of the lines of a block in place of `values`, and says which line is the first.
pub(super) fn lines(
    chunk: &Chunk,
    header: &Header,
    values: &mut Vec<f32>,
) -> exr::error::Result<usize> {
    let malformed = |what: &'static str| exr::error::Error::Invalid(what.into());
    let CompressedBlock::ScanLine(block) = &chunk.compressed_block else {
        return Err(malformed("a block of another kind than the header says"));
    };
    let indices = header.get_block_data_indices(&chunk.compressed_block)?;
    let place = header.get_absolute_block_pixel_coordinates(indices)?;
    place.validate(Some(header.layer_size))?;
    let Vec2(_, row) = place.position.to_usize("a line before the first")?;
    let packed = &block.compressed_pixels_le;
    let size = 4 * place.size.area();
    values.resize(place.size.area(), 0.0);
    if packed.len() == size {
        // Deflate would have made it larger.
        bytemuck::cast_slice_mut(values).copy_from_slice(packed);
        from_little_endian(values);
        return Ok(row);
    }
    let options = zune_inflate::DeflateOptions::default()
        .set_limit(size)
        .set_size_hint(size);
    let mut decoder = zune_inflate::DeflateDecoder::new_with_options(packed, options);
    let bytes = decoder.decode_zlib().ok();
    let bytes = bytes.filter(|bytes| bytes.len() == size);
    let mut bytes = bytes.ok_or_else(|| malformed("zlib-compressed data malformed"))?;
    add_up(&mut bytes);
    interleave(&bytes, values);
    Ok(row)
}

/// Values of their bytes, in little-endian order: those of even places in the first half, those of odd places in the
/// second.
fn interleave(bytes: &[u8], values: &mut [f32]) {
    const PIECE: usize = 16;
    let (even, odd) = bytes.split_at(bytes.len() / 2);
    let ((evens, even), (odds, odd)) = (even.as_chunks::<PIECE>(), odd.as_chunks::<PIECE>());
    let (pieces, rest) =
        bytemuck::cast_slice_mut::<f32, u8>(values).as_chunks_mut::<{ 2 * PIECE }>();
    // Of pieces of one size the compiler makes a single step of the vector units.
    for (piece, (even, odd)) in pieces.iter_mut().zip(evens.iter().zip(odds)) {
        for (pair, (even, odd)) in (piece.as_chunks_mut().0.iter_mut()).zip(even.iter().zip(odd)) {
            *pair = [*even, *odd];
        }
    }
    for (pair, (even, odd)) in rest.as_chunks_mut().0.iter_mut().zip(even.iter().zip(odd)) {
        *pair = [*even, *odd];
    }
    from_little_endian(values);
}

/// Makes bytes of differences to the byte before, plus 128.
fn add_up(bytes: &mut [u8]) {
    #[cfg(target_arch = "x86_64")]
    if let Some(simd) = pulp::x86::V2::try_new() {
        simd.vectorize(x86::AddUp { simd, bytes });
        return;
    }
    add_up_one_by_one(bytes, FLIPPED);
}

/// The first byte stands for itself: it is the difference to this one.
const FLIPPED: u8 = 128;

fn add_up_one_by_one(bytes: &mut [u8], mut last: u8) {
    for byte in bytes {
        // Modulo 256 it is all the same whether 128 is taken away or added.
        last = last.wrapping_add(*byte ^ FLIPPED);
        *byte = last;
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::__m128i;

    use super::{FLIPPED, add_up_one_by_one};

    /// Sixteen bytes at a time: sums of 2, 4, 8 and 16 bytes, then the last byte before them.
    pub(super) struct AddUp<'a> {
        pub(super) simd: pulp::x86::V2,
        pub(super) bytes: &'a mut [u8],
    }

    impl pulp::NullaryFnOnce for AddUp<'_> {
        type Output = ();

        #[inline(always)]
        fn call(self) {
            let (sse2, ssse3) = (self.simd.sse2, self.simd.ssse3);
            let (pieces, rest) = self.bytes.as_chunks_mut::<16>();
            let flipped: __m128i = pulp::cast([FLIPPED; 16]);
            let of_last: __m128i = pulp::cast([15_u8; 16]);
            let mut last = flipped;
            for piece in pieces {
                let mut sums = sse2._mm_xor_si128(pulp::cast(*piece), flipped);
                sums = sse2._mm_add_epi8(sums, sse2._mm_slli_si128::<1>(sums));
                sums = sse2._mm_add_epi8(sums, sse2._mm_slli_si128::<2>(sums));
                sums = sse2._mm_add_epi8(sums, sse2._mm_slli_si128::<4>(sums));
                sums = sse2._mm_add_epi8(sums, sse2._mm_slli_si128::<8>(sums));
                *piece = pulp::cast(sse2._mm_add_epi8(sums, last));
                last = sse2._mm_add_epi8(last, ssse3._mm_shuffle_epi8(sums, of_last));
            }
            let last: [u8; 16] = pulp::cast(last);
            add_up_one_by_one(rest, last[15]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_add_up_as_one_by_one() {
        for length in [0, 1, 15, 16, 17, 64, 1001] {
            let bytes: Vec<u8> = (0..length)
                .map(|i: u32| (i.wrapping_mul(2_654_435_761) >> 13) as u8)
                .collect();
            let mut expected = bytes.clone();
            add_up_one_by_one(&mut expected, FLIPPED);
            let mut found = bytes;
            add_up(&mut found);
            assert_eq!(found, expected, "{length}");
        }
    }

    #[test]
    fn bytes_of_even_places_come_first() {
        for count in [0, 1, 2, 31, 32, 33, 100] {
            let values: Vec<f32> = (0..count).map(|i| i as f32 * 0.37 - 2.5).collect();
            let bytes: Vec<u8> = values
                .iter()
                .flat_map(|value| value.to_le_bytes())
                .collect();
            let even = bytes.iter().step_by(2);
            let odd = bytes.iter().skip(1).step_by(2);
            let halves: Vec<u8> = even.chain(odd).copied().collect();
            let mut found = vec![f32::NAN; values.len()];
            interleave(&halves, &mut found);
            assert_eq!(found, values, "{count}");
        }
    }
}
