//! Why there is no table.

use crate::rows::RowsError;
use crate::thesis::ThesisTable;

/// Why there is no table.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TableError {
    /// Rows that do not belong together.
    #[error(transparent)]
    Rows(#[from] RowsError),
    /// Rows of a protocol that has changed since.
    #[error(
        "the rows of model {model} were measured under another definition of {protocol} (digest \
         {found}; here it is {expected}), so measure again with this version"
    )]
    Definition {
        /// Model name.
        model: String,
        /// Protocol name.
        protocol: String,
        /// Digest in the rows.
        found: String,
        /// Digest of the protocol in this program.
        expected: String,
    },
    /// Models measured on different data.
    #[error(
        "models {first} and {second} were measured on different data (digests {first_digest} and \
         {second_digest}) and cannot share a table"
    )]
    Data {
        /// A model.
        first: String,
        /// Its data.
        first_digest: String,
        /// Another model.
        second: String,
        /// Its data.
        second_digest: String,
    },
    /// More images than the set has.
    #[error(
        "the rows of model {model} under {protocol} name {found} images where the test set has \
         {expected}"
    )]
    Excess {
        /// Model name.
        model: String,
        /// Protocol name.
        protocol: String,
        /// Images in the rows.
        found: u64,
        /// Images of the set.
        expected: u64,
    },
    /// Wrong number of protocols.
    #[error("table {table} has {expected} section(s) but {found} protocol(s) were named for it")]
    Sections {
        /// The table.
        table: ThesisTable,
        /// Protocols needed.
        expected: usize,
        /// Protocols given.
        found: usize,
    },
}
