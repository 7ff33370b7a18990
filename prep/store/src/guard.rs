//! Panics inside libraries as sentences.
//!
//! A decoder that meets a file nobody thought of may panic; to a user that is a bad file like any
//! other. Each library that foreign data reaches is called through [`guarded`] at one place. Panics
//! of this workspace's own code are told as ever: they are its faults.

use std::any::Any;
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Once;

thread_local! {
    /// Calls of [`guarded`] that this thread is in.
    static DEPTH: Cell<usize> = const { Cell::new(0) };
}

/// Does `work`, which is a library's; `library` names it in the sentence.
///
/// # Errors
/// It panicked; the sentence has what it said.
pub fn guarded<T>(library: &str, work: impl FnOnce() -> T) -> Result<T, String> {
    silence();
    DEPTH.set(DEPTH.get() + 1);
    let done = catch_unwind(AssertUnwindSafe(work));
    DEPTH.set(DEPTH.get() - 1);
    done.map_err(|panic| format!("{library} gave up on it ({})", said(&*panic)))
}

fn said(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    let text = text.or_else(|| panic.downcast_ref::<String>().map(String::as_str));
    text.unwrap_or("no reason stated")
}

/// Keeps the trace of a guarded panic off the terminal; all others are told as before.
fn silence() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            if DEPTH.get() == 0 {
                before(info);
            }
        }));
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_a_sentence_and_the_work_goes_on() {
        assert_eq!(guarded("the decoder", || 7), Ok(7));
        let index = std::hint::black_box(3);
        let problem = guarded("the decoder", || [1, 2][index]).unwrap_err();
        assert!(
            problem.starts_with("the decoder gave up on it (index out of bounds"),
            "{problem}"
        );
        let plain = guarded("x", || -> i32 { panic!("why") });
        assert_eq!(plain, Err("x gave up on it (why)".to_owned()));
        let inner = guarded("outer", || guarded("inner", || -> i32 { panic!("{}", 1) }));
        assert_eq!(inner, Ok(Err("inner gave up on it (1)".to_owned())));
        assert_eq!(DEPTH.get(), 0);
    }
}
