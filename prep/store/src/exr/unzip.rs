//! Blocks of one 32-bit channel that OpenEXR's ZIP methods have packed, straight to values.
//!
//! Ground truth is decoded more often than anything else. The decoder for every kind of file goes over a
//! block five times after inflating it; for the one kind that `prep` writes two are enough. What is stored: the
//! bytes of even places, then those of odd places, each as the difference to the one before, plus 128, and all
//! that deflated. Not here: any other kind of block, which [`exr`] decodes.

use exr::block::chunk::{Chunk, CompressedBlock};
use exr::compression::Compression;
use exr::math::Vec2;
use exr::meta::attribute::SampleType;
use exr::meta::header::Header;

/// Values of whole lines of a layer.
pub(super) struct Lines {
    /// Number of the first line.
    pub(super) row: usize,
    /// Values of each line.
    pub(super) width: usize,
    /// Line by line.
    pub(super) values: Vec<f32>,
}

/// The lines of a block; `None` where it is of another kind.
pub(super) fn lines(chunk: &Chunk, header: &Header) -> exr::error::Result<Option<Lines>> {
    let is_known = matches!(header.compression, Compression::ZIP16 | Compression::ZIP1)
        && matches!(header.channels.list.as_slice(), [only] if only.sample_type == SampleType::F32);
    let CompressedBlock::ScanLine(block) = &chunk.compressed_block else {
        return Ok(None);
    };
    if !is_known {
        return Ok(None);
    }
    let indices = header.get_block_data_indices(&chunk.compressed_block)?;
    let place = header.get_absolute_block_pixel_coordinates(indices)?;
    place.validate(Some(header.layer_size))?;
    let Vec2(_, row) = place.position.to_usize("a line before the first")?;
    let packed = &block.compressed_pixels_le;
    let values = if packed.len() == 4 * place.size.area() {
        // Deflate would have made it larger.
        let (bytes, _) = packed.as_chunks();
        bytes
            .iter()
            .map(|bytes| f32::from_le_bytes(*bytes))
            .collect()
    } else {
        let options = zune_inflate::DeflateOptions::default()
            .set_limit(4 * place.size.area())
            .set_size_hint(4 * place.size.area());
        let mut decoder = zune_inflate::DeflateDecoder::new_with_options(packed, options);
        let malformed = || exr::error::Error::Invalid("zlib-compressed data malformed".into());
        let mut bytes = decoder.decode_zlib().map_err(|_| malformed())?;
        if bytes.len() != 4 * place.size.area() {
            return Err(malformed());
        }
        add_up(&mut bytes);
        interleaved(&bytes)
    };
    Ok(Some(Lines {
        row,
        width: place.size.width(),
        values,
    }))
}

/// Values of their bytes: those of even places in the first half, those of odd places in the second. By way of
/// halves of values, of which the processor makes many at a time.
fn interleaved(bytes: &[u8]) -> Vec<f32> {
    const PIECE: usize = 64;
    let (even, odd) = bytes.split_at(bytes.len() / 2);
    let mut values = Vec::with_capacity(bytes.len() / 4);
    let mut halves = [0_u16; PIECE];
    for (even, odd) in even.chunks(PIECE).zip(odd.chunks(PIECE)) {
        let halves = &mut halves[..even.len()];
        for ((half, even), odd) in halves.iter_mut().zip(even).zip(odd) {
            *half = u16::from_le_bytes([*even, *odd]);
        }
        let value =
            |&[low, high]: &[u16; 2]| f32::from_bits(u32::from(low) | u32::from(high) << 16);
        values.extend(halves.as_chunks().0.iter().map(value));
    }
    values
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
            assert_eq!(interleaved(&halves), values, "{count}");
        }
    }
}
