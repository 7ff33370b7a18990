//! MATLAB 5 files (`.mat`), as far as Make3D needs them: one real numeric array by name.
//!
//! The format is that of "MAT-File Format", MathWorks, chapter 1. Compressed elements are
//! inflated up to a fixed size; sparse, complex, cell and structure arrays and the HDF5 files of
//! version 7.3 are not read. Values keep MATLAB's order, first dimension fastest.

use std::io::Read;

use flate2::read::ZlibDecoder;
use strat_store::guard::guarded;

/// Most bytes a compressed element may inflate to; a Make3D grid takes half a megabyte.
const MAX_INFLATED: u64 = 64 << 20;

/// Bytes of text, version and byte order before the first element.
const HEADER: usize = 128;

const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;

/// A real array.
#[derive(Debug, Clone, PartialEq)]
pub struct Matrix {
    /// Lengths of its dimensions.
    pub dims: Vec<usize>,
    /// Values, first dimension fastest; as many as the product of `dims`.
    pub values: Vec<f64>,
}

/// The array called `name`.
///
/// # Errors
/// The bytes are no MATLAB 5 file, cut off, or have no real numeric array of this name.
pub fn read(bytes: &[u8], name: &str) -> Result<Matrix, String> {
    let Some((header, mut rest)) = bytes.split_at_checked(HEADER) else {
        return Err(format!(
            "it is not a MATLAB 5 file: {} bytes are less than its header",
            bytes.len()
        ));
    };
    let big_endian = match &header[126..] {
        b"IM" => false,
        b"MI" => true,
        _ => {
            return Err(
                "it is not a MATLAB 5 file (save it with `-v6` or `-v7`; 7.3 is not read)"
                    .to_owned(),
            );
        }
    };
    while !rest.is_empty() {
        let element = take(&mut rest, big_endian)?;
        let inflated;
        let matrix = match element.kind {
            COMPRESSED => {
                inflated = inflate(element.data)?;
                let mut inner = &inflated[..];
                let element = take(&mut inner, big_endian)?;
                if element.kind != MATRIX {
                    continue;
                }
                element.data
            }
            MATRIX => element.data,
            _ => continue,
        };
        if let Some(found) = named(matrix, name, big_endian)? {
            return Ok(found);
        }
    }
    Err(format!("it holds no array `{name}`"))
}

struct Element<'a> {
    kind: u32,
    data: &'a [u8],
}

fn cut_off() -> String {
    "it is cut off".to_owned()
}

/// Takes the first element off `rest`.
fn take<'a>(rest: &mut &'a [u8], big_endian: bool) -> Result<Element<'a>, String> {
    let (tag, behind) = rest.split_first_chunk::<8>().ok_or_else(cut_off)?;
    let word = |at: usize| {
        let bytes = [tag[at], tag[at + 1], tag[at + 2], tag[at + 3]];
        match big_endian {
            true => u32::from_be_bytes(bytes),
            false => u32::from_le_bytes(bytes),
        }
    };
    let (kind, length) = (word(0), word(4) as usize);
    // Up to four bytes stand in the tag itself, and then the type shares its word with the length.
    if kind >> 16 != 0 {
        let length = (kind >> 16) as usize;
        let data = rest[4..8]
            .get(..length)
            .ok_or("an element is longer than its place")?;
        *rest = behind;
        return Ok(Element {
            kind: kind & 0xffff,
            data,
        });
    }
    let data = behind.get(..length).ok_or_else(cut_off)?;
    // Elements begin on multiples of eight bytes; compressed ones follow each other directly.
    let end = match kind {
        COMPRESSED => length,
        _ => length.next_multiple_of(8).min(behind.len()),
    };
    *rest = &behind[end..];
    Ok(Element { kind, data })
}

fn inflate(data: &[u8]) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    let mut inflate = ZlibDecoder::new(data).take(MAX_INFLATED + 1);
    guarded("the decompressor", || inflate.read_to_end(&mut bytes))?
        .map_err(|e| format!("its compressed data is damaged ({e})"))?;
    if bytes.len() as u64 > MAX_INFLATED {
        return Err(format!(
            "it holds more than {} MB in one array",
            MAX_INFLATED >> 20
        ));
    }
    Ok(bytes)
}

/// The matrix if it has this name, and `None` if it has another.
fn named(mut rest: &[u8], name: &str, big_endian: bool) -> Result<Option<Matrix>, String> {
    let flags = numbers(&take(&mut rest, big_endian)?, big_endian)?;
    let dims = numbers(&take(&mut rest, big_endian)?, big_endian)?;
    if take(&mut rest, big_endian)?.data != name.as_bytes() {
        return Ok(None);
    }
    let flags = flags.first().copied().unwrap_or(0.0) as u32;
    let (class, complex) = (flags & 0xff, flags & 0x800 != 0);
    // Classes 6 to 15 are the numeric ones, from double to uint64.
    if !(6..=15).contains(&class) || complex {
        return Err(format!(
            "its array `{name}` is not an array of real numbers"
        ));
    }
    let dims: Option<Vec<usize>> = dims
        .iter()
        .map(|side| (*side >= 0.0).then_some(*side as usize))
        .collect();
    let values = numbers(&take(&mut rest, big_endian)?, big_endian)?;
    let dims = dims.ok_or("a dimension is negative")?;
    let expected = dims
        .iter()
        .try_fold(1_usize, |product, side| product.checked_mul(*side));
    if expected != Some(values.len()) {
        return Err(format!(
            "its array `{name}` of {dims:?} has {} values",
            values.len()
        ));
    }
    Ok(Some(Matrix { dims, values }))
}

/// The numbers of an element; MATLAB stores whole-numbered doubles in smaller types.
fn numbers(element: &Element<'_>, big_endian: bool) -> Result<Vec<f64>, String> {
    let size = match element.kind {
        1 | 2 => 1,
        3 | 4 => 2,
        5..=7 => 4,
        9 | 12 | 13 => 8,
        other => return Err(format!("an element has the unknown type {other}")),
    };
    if !element.data.len().is_multiple_of(size) {
        return Err(cut_off());
    }
    let number = |bytes: &[u8]| {
        let mut low_first = [0; 8];
        low_first[..size].copy_from_slice(bytes);
        if big_endian {
            low_first[..size].reverse();
        }
        let [a, b, c, d, ..] = low_first;
        match element.kind {
            1 => f64::from(a as i8),
            2 => f64::from(a),
            3 => f64::from(i16::from_le_bytes([a, b])),
            4 => f64::from(u16::from_le_bytes([a, b])),
            5 => f64::from(i32::from_le_bytes([a, b, c, d])),
            6 => f64::from(u32::from_le_bytes([a, b, c, d])),
            7 => f64::from(f32::from_le_bytes([a, b, c, d])),
            12 => i64::from_le_bytes(low_first) as f64,
            13 => u64::from_le_bytes(low_first) as f64,
            _ => f64::from_le_bytes(low_first),
        }
    };
    Ok(element.data.chunks_exact(size).map(number).collect())
}

#[cfg(test)]
pub(crate) mod tests {
    use std::io::Write;

    use flate2::Compression;
    use flate2::write::ZlibEncoder;
    use proptest::prelude::*;

    use super::*;

    fn element(kind: u32, data: &[u8]) -> Vec<u8> {
        let mut bytes = [kind.to_le_bytes(), (data.len() as u32).to_le_bytes()].concat();
        bytes.extend_from_slice(data);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    }

    /// A little-endian file with one compressed array of doubles, put together by the format's
    /// description.
    pub fn file(name: &str, dims: &[u32], values: &[f64]) -> Vec<u8> {
        let flags = [6u32.to_le_bytes(), 0u32.to_le_bytes()].concat();
        let dims: Vec<u8> = dims.iter().flat_map(|side| side.to_le_bytes()).collect();
        let values: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let matrix = [
            element(6, &flags),
            element(5, &dims),
            element(1, name.as_bytes()),
            element(9, &values),
        ]
        .concat();
        let mut zlib = ZlibEncoder::new(Vec::new(), Compression::fast());
        zlib.write_all(&element(MATRIX, &matrix)).unwrap();
        let packed = zlib.finish().unwrap();
        let mut bytes = vec![b' '; HEADER];
        bytes[124..].copy_from_slice(b"\x00\x01IM");
        bytes.extend_from_slice(&COMPRESSED.to_le_bytes());
        bytes.extend_from_slice(&(packed.len() as u32).to_le_bytes());
        bytes.extend(packed);
        bytes
    }

    #[test]
    fn arrays_are_found_by_name() {
        let mut two = file("other", &[1, 1], &[9.0]);
        two.extend_from_slice(&file("grid", &[2, 3], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.5])[HEADER..]);
        let found = read(&two, "grid").unwrap();
        assert_eq!(found.dims, [2, 3]);
        assert_eq!(found.values, [1.0, 2.0, 3.0, 4.0, 5.0, 6.5]);
        assert!(read(&two, "Grid").unwrap_err().contains("no array `Grid`"));
    }

    #[test]
    fn small_elements_and_integers_are_understood() {
        // uint8 values in the tag itself, as MATLAB stores small whole numbers.
        let mut bytes = vec![b' '; HEADER];
        bytes[124..].copy_from_slice(b"\x00\x01IM");
        let matrix = [
            element(6, &[6, 0, 0, 0, 0, 0, 0, 0]),
            element(5, &[1, 0, 0, 0, 3, 0, 0, 0]),
            vec![1, 0, 1, 0, b'x', 0, 0, 0],
            vec![2, 0, 3, 0, 7, 8, 255, 0],
        ]
        .concat();
        bytes.extend(element(MATRIX, &matrix));
        let found = read(&bytes, "x").unwrap();
        assert_eq!(found.dims, [1, 3]);
        assert_eq!(found.values, [7.0, 8.0, 255.0]);
    }

    #[test]
    fn damage_is_explained() {
        let whole = file("grid", &[2, 3], &[0.5; 6]);
        for (bytes, reason) in [
            (whole[..100].to_vec(), "less than its header"),
            (whole[..whole.len() - 6].to_vec(), "cut off"),
            (vec![0; 200], "not a MATLAB 5 file"),
            (file("grid", &[2, 4], &[0.5; 6]), "has 6 values"),
            (file("grid", &[0x7fff_ffff; 9], &[0.5; 6]), "has 6 values"),
            (
                {
                    let mut b = whole.clone();
                    b[HEADER + 12] ^= 0xff;
                    b
                },
                "damaged",
            ),
        ] {
            let problem = read(&bytes, "grid").unwrap_err();
            assert!(
                problem.contains(reason),
                "{problem} should contain {reason}"
            );
        }
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300), big: bool) {
            let mut file = [0; HEADER];
            file[126..].copy_from_slice(if big { b"MI" } else { b"IM" });
            let _ = read(&bytes, "x");
            let _ = read(&[&file[..], &bytes].concat(), "x");
            let _ = read(&[&file[..], &element(MATRIX, &bytes)].concat(), "x");
            let _ = named(&bytes, "", big);
        }
    }
}
