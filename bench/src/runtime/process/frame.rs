//! What goes between the two processes: a header in JSON and the values of one tensor.
//!
//! ```text
//! length of the header, number of values (little-endian u64 each) | header | f32 values
//! ```
//! Both ends are the same program on one machine, so values go as they lie in memory.

use std::io::{self, Read, Write};

use serde::{Serialize, de::DeserializeOwned};

/// Most bytes of a header: names and shapes.
const LONGEST_HEADER: u64 = 1 << 20;

/// Most values of one tensor, 1.1 GB.
pub const MOST_VALUES: u64 = 1 << 28;

/// Writes one frame.
pub fn write(out: &mut impl Write, header: &impl Serialize, values: &[f32]) -> io::Result<()> {
    let header = serde_json::to_vec(header)?;
    let lengths = [header.len() as u64, values.len() as u64];
    let mut start = Vec::with_capacity(16 + header.len());
    start.extend(lengths.iter().flat_map(|length| length.to_le_bytes()));
    start.extend(header);
    out.write_all(&start)?;
    out.write_all(bytemuck::cast_slice(values))?;
    out.flush()
}

/// Reads one frame; `None` where the other end has closed.
pub fn read<T: DeserializeOwned>(input: &mut impl Read) -> io::Result<Option<(T, Vec<f32>)>> {
    let odd = |what: &str| io::Error::new(io::ErrorKind::InvalidData, what.to_owned());
    let mut lengths = [0; 16];
    match input.read_exact(&mut lengths) {
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(None),
        read => read?,
    }
    let [header, values] = [0, 8].map(|at| {
        let bytes: [u8; 8] = std::array::from_fn(|index| lengths[at + index]);
        u64::from_le_bytes(bytes)
    });
    if header > LONGEST_HEADER || values > MOST_VALUES {
        return Err(odd("a frame of impossible length"));
    }
    let mut text = vec![0; header as usize];
    input.read_exact(&mut text)?;
    let header = serde_json::from_slice(&text).map_err(|_| odd("an unknown header"))?;
    let mut tensor = vec![0.0; values as usize];
    input.read_exact(bytemuck::cast_slice_mut(&mut tensor))?;
    Ok(Some((header, tensor)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_come_back() {
        let mut bytes = Vec::new();
        write(&mut bytes, &"first", &[0.5, -0.0, f32::INFINITY]).unwrap();
        write(&mut bytes, &7, &[]).unwrap();
        let mut input = bytes.as_slice();
        let first: (String, Vec<f32>) = read(&mut input).unwrap().unwrap();
        assert_eq!(first, ("first".to_owned(), vec![0.5, -0.0, f32::INFINITY]));
        assert_eq!(read::<i32>(&mut input).unwrap(), Some((7, Vec::new())));
        assert_eq!(read::<i32>(&mut input).unwrap(), None);
    }

    #[test]
    fn whatever_else_is_there_is_an_error_and_takes_no_memory() {
        for bytes in [
            [0xff; 64].as_slice(),
            b"Hello, this is a library that prints.",
        ] {
            assert!(read::<i32>(&mut &bytes[..]).is_err());
        }
        let mut cut = Vec::new();
        write(&mut cut, &7, &[1.0; 10]).unwrap();
        cut.truncate(40);
        assert!(read::<i32>(&mut cut.as_slice()).is_err());
    }
}
