//! Reads NumPy arrays of predictions plane by plane, at flat memory.
//!
//! The format is NumPy's NEP 1 (versions 1 to 3): a magic, a length, a Python literal of three
//! keys, then the values. Only what predictions are is read: little-endian floats of 4 or 8 bytes
//! in C order, shaped `N x H x W`, `N x 1 x H x W` or `N x H x W x 1`; a single map may be `H x W`.
//! Pickled objects are refused. Problems are sentences that do not name the file.

use std::{
    fs::File,
    io::{Read, Seek, SeekFrom},
};

/// Longest header read; NumPy's own is below 200 bytes.
const LONGEST_HEADER: usize = 4096;

/// Where the planes of an array lie in its file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Planes.
    pub count: usize,
    /// Rows of each.
    pub height: usize,
    /// Columns of each.
    pub width: usize,
    value_bytes: usize,
    start: u64,
}

/// An open array.
#[derive(Debug)]
pub struct NpyPlanes {
    file: File,
    /// Shape and place of the values.
    pub layout: Layout,
}

impl NpyPlanes {
    /// Takes a file and holds its length against its header.
    ///
    /// # Errors
    /// No NumPy array, another type or shape, or a file that was cut short.
    pub fn new(mut file: File) -> Result<Self, String> {
        let io = |error: std::io::Error| error.to_string();
        let length = file.metadata().map_err(io)?.len();
        let mut start = Vec::new();
        file.seek(SeekFrom::Start(0)).map_err(io)?;
        (&mut file)
            .take(LONGEST_HEADER as u64 + 12)
            .read_to_end(&mut start)
            .map_err(io)?;
        let layout = parse_header(&start)?;
        let needed = (layout.count as u64)
            .checked_mul(plane_bytes(&layout) as u64)
            .and_then(|bytes| bytes.checked_add(layout.start));
        if needed != Some(length) {
            return Err(format!(
                "its header speaks of {} maps of {}x{}, but it has {length} bytes; it is \
                 incomplete or damaged",
                layout.count, layout.width, layout.height
            ));
        }
        Ok(Self { file, layout })
    }

    /// Reads one plane, row-major.
    ///
    /// # Errors
    /// `index` is beyond the array, or the system refuses.
    pub fn plane(&mut self, index: usize) -> Result<Vec<f32>, String> {
        if index >= self.layout.count {
            return Err(format!(
                "it has {} maps, so there is no number {index}",
                self.layout.count
            ));
        }
        let size = plane_bytes(&self.layout);
        let mut bytes = vec![0; size];
        let place = self.layout.start + index as u64 * size as u64;
        self.file
            .seek(SeekFrom::Start(place))
            .and_then(|_| self.file.read_exact(&mut bytes))
            .map_err(|error| error.to_string())?;
        Ok(match self.layout.value_bytes {
            4 => {
                let values = bytes.as_chunks::<4>().0.iter();
                values.map(|value| f32::from_le_bytes(*value)).collect()
            }
            _ => {
                let values = bytes.as_chunks::<8>().0.iter();
                values
                    .map(|value| f64::from_le_bytes(*value) as f32)
                    .collect()
            }
        })
    }
}

/// Cannot overflow: [`parse_header`] has checked the product.
fn plane_bytes(layout: &Layout) -> usize {
    layout.height * layout.width * layout.value_bytes
}

fn parse_header(bytes: &[u8]) -> Result<Layout, String> {
    let no_array = || "it is no NumPy array (.npy)".to_owned();
    let rest = bytes.strip_prefix(b"\x93NUMPY").ok_or_else(no_array)?;
    let (length, before) = match *rest {
        [1, _, a, b, ..] => (usize::from(u16::from_le_bytes([a, b])), 10),
        [2 | 3, _, a, b, c, d, ..] => (u32::from_le_bytes([a, b, c, d]) as usize, 12),
        _ => return Err(no_array()),
    };
    if length > LONGEST_HEADER {
        return Err(format!(
            "its header of {length} bytes is too long for an array of numbers"
        ));
    }
    let text = bytes
        .get(before..before + length)
        .and_then(|text| std::str::from_utf8(text).ok())
        .ok_or("its header is incomplete or damaged")?;
    let after = |key: &str| {
        let (_, value) = text.split_once(&format!("'{key}':"))?;
        Some(value.trim_start())
    };
    let (Some(descr), Some(order), Some(shape)) =
        (after("descr"), after("fortran_order"), after("shape"))
    else {
        return Err("its header is damaged".to_owned());
    };
    let value_bytes = if descr.starts_with("'<f4'") {
        4
    } else if descr.starts_with("'<f8'") {
        8
    } else {
        let found: String = descr.chars().take(16).collect();
        return Err(format!(
            "its values are {found}; save them as float32: np.save(FILE, array.astype('<f4'))"
        ));
    };
    if !order.starts_with("False") {
        return Err("it is in Fortran order; save np.ascontiguousarray(array)".to_owned());
    }
    let numbers = shape
        .strip_prefix('(')
        .and_then(|s| s.split_once(')'))
        .map(|(inside, _)| inside);
    let dims: Option<Vec<usize>> = numbers.map(str::trim).and_then(|inside| {
        inside
            .trim_end_matches(',')
            .split(',')
            .map(|part| part.trim().parse().ok())
            .collect()
    });
    let dims = dims.ok_or("the shape in its header is damaged")?;
    let (count, height, width) = match *dims.as_slice() {
        [n, h, w] | [n, 1, h, w] | [n, h, w, 1] => (n, h, w),
        [h, w] => (1, h, w),
        _ => {
            return Err(format!(
                "its shape is {dims:?}; [images, height, width] is needed"
            ));
        }
    };
    let plane = height
        .checked_mul(width)
        .and_then(|plane| plane.checked_mul(value_bytes));
    if plane.is_none_or(|bytes| bytes == 0 || bytes > 1 << 32) {
        return Err(format!("its shape is {dims:?}, which no predictions have"));
    }
    Ok(Layout {
        count,
        height,
        width,
        value_bytes,
        start: (before + length) as u64,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(text: &str, values: &[u8]) -> File {
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((text.len() as u16).to_le_bytes());
        bytes.extend(text.bytes());
        bytes.extend(values);
        let mut file = tempfile::tempfile().unwrap();
        std::io::Write::write_all(&mut file, &bytes).unwrap();
        file
    }

    fn f4(shape: &str) -> String {
        format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}\n")
    }

    #[test]
    fn planes_come_in_order() {
        let values: Vec<u8> = (0..12_u8)
            .flat_map(|v| f32::from(v).to_le_bytes())
            .collect();
        for shape in ["(2, 2, 3)", "(2, 1, 2, 3)", "(2, 2, 3, 1)"] {
            let mut planes = NpyPlanes::new(file(&f4(shape), &values)).unwrap();
            assert_eq!(planes.plane(1).unwrap(), [6.0, 7.0, 8.0, 9.0, 10.0, 11.0]);
            assert_eq!(planes.plane(0).unwrap()[5], 5.0);
            assert!(planes.plane(2).is_err());
        }
        let mut one = NpyPlanes::new(file(&f4("(3, 4)"), &values)).unwrap();
        assert_eq!(one.plane(0).unwrap().len(), 12);
        let doubles: Vec<u8> = [0.5_f64, 2.0]
            .iter()
            .flat_map(|v| v.to_le_bytes())
            .collect();
        let text = f4("(1, 1, 2)").replace("<f4", "<f8");
        let mut planes = NpyPlanes::new(file(&text, &doubles)).unwrap();
        assert_eq!(planes.plane(0).unwrap(), [0.5, 2.0]);
    }

    #[test]
    fn broken_headers_are_sentences() {
        for (text, wanted) in [
            (f4("(2,)"), "shape is [2]"),
            (f4("(2, 2, 3)"), "incomplete"),
            (f4("(2, 18446744073709551615, 3)"), "no predictions"),
            (f4("(2, x, 3)"), "damaged"),
            (f4("(2, 2, 3)").replace("<f4", "|O"), "float32"),
            (f4("(2, 2, 3)").replace("False", "True"), "Fortran"),
            ("((((((((".repeat(400), "damaged"),
        ] {
            let error = NpyPlanes::new(file(&text, &[0; 47])).unwrap_err();
            assert!(error.contains(wanted), "{error}");
        }
    }

    #[test]
    fn no_prefix_of_a_file_panics() {
        let mut whole = Vec::new();
        file(&f4("(1, 1, 1)"), &[0; 4])
            .try_clone()
            .and_then(|mut f| {
                f.seek(SeekFrom::Start(0))?;
                f.read_to_end(&mut whole)
            })
            .unwrap();
        for end in 0..whole.len() {
            assert!(parse_header(&whole[..end.min(60)]).is_err());
        }
        assert!(parse_header(&whole).is_ok());
    }
}
