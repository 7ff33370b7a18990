//! An array of maps of several sizes as NumPy stores it: an object array, whose values are a pickle.
//!
//! The layout is numpy.lib.format's and Python's pickle protocol 3: for each array what `ndarray.__reduce__` and
//! `ndarray.__setstate__` exchange. Only written, never read: loading a pickle runs what it says.

use std::io::{self, Write};

use strat_store::raster::Plane;

/// Writes the beginning of the `.npy` of `count` maps; each follows by [`map`], and [`end`] ends it.
pub(crate) fn begin(out: &mut impl Write, count: usize) -> io::Result<()> {
    let mut header = format!("{{'descr': '|O', 'fortran_order': False, 'shape': ({count},), }}");
    // Magic, version and length take ten bytes; all of it together a multiple of 64.
    while !(10 + header.len() + 1).is_multiple_of(64) {
        header.push(' ');
    }
    header.push('\n');
    out.write_all(b"\x93NUMPY\x01\x00")?;
    out.write_all(&(header.len() as u16).to_le_bytes())?;
    out.write_all(header.as_bytes())?;
    out.write_all(b"\x80\x03")?;
    array(out, &[count], "O8", b'|', 63)?;
    // A list of what follows.
    out.write_all(b"](")
}

/// Writes one map.
pub(crate) fn map(out: &mut impl Write, plane: &Plane) -> io::Result<()> {
    array(out, &[plane.height, plane.width], "f4", b'<', 0)?;
    out.write_all(b"B")?;
    out.write_all(&((4 * plane.data.len()) as u32).to_le_bytes())?;
    for value in &plane.data {
        out.write_all(&value.to_le_bytes())?;
    }
    out.write_all(b"tb")
}

/// Ends the list, the array and the pickle.
pub(crate) fn end(out: &mut impl Write) -> io::Result<()> {
    out.write_all(b"etb.")
}

/// An array up to its values: `_reconstruct(ndarray, (0,), b"b")` and the state (version, shape, type, order)
/// that is still open.
fn array(
    out: &mut impl Write,
    shape: &[usize],
    kind: &str,
    order: u8,
    flags: u8,
) -> io::Result<()> {
    out.write_all(
        b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R(K\x01",
    )?;
    for side in shape {
        out.write_all(b"J")?;
        out.write_all(&(*side as i32).to_le_bytes())?;
    }
    out.write_all(if shape.len() == 1 { b"\x85" } else { b"\x86" })?;
    // dtype(kind, False, True) with the state (3, order, None, None, None, -1, -1, flags).
    out.write_all(b"cnumpy\ndtype\nX\x02\x00\x00\x00")?;
    out.write_all(kind.as_bytes())?;
    out.write_all(b"\x89\x88\x87R(K\x03X\x01\x00\x00\x00")?;
    out.write_all(&[order])?;
    out.write_all(b"NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK")?;
    out.write_all(&[flags])?;
    out.write_all(b"tb\x89")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Recipe: the bytes were read with `numpy.load(FILE, allow_pickle=True)` of NumPy 2, which gives the two
    /// maps; the length is held here.
    #[test]
    fn maps_of_two_sizes_are_one_array() {
        let mut bytes = Vec::new();
        begin(&mut bytes, 2).unwrap();
        map(&mut bytes, &Plane::new(2, 1, vec![1.0, 2.0]).unwrap()).unwrap();
        map(&mut bytes, &Plane::new(1, 3, vec![3.0, 4.0, 5.0]).unwrap()).unwrap();
        end(&mut bytes).unwrap();
        assert!(bytes.starts_with(b"\x93NUMPY\x01\x00"));
        assert_eq!(&bytes[128..130], b"\x80\x03");
        assert_eq!(
            bytes
                .windows(14)
                .filter(|part| part == b"_reconstruct\nc")
                .count(),
            3
        );
        assert!(bytes.ends_with(b"\x00\x00\xa0@tbetb."), "5.0, and the ends");
    }
}
