//! Thread pools.

use crate::error::{Error, Result};

/// A pool of `threads` threads called `NAME-0`, `NAME-1`, ...; 0 asks for one for each core.
///
/// # Errors
/// The operating system does not start them.
pub fn pool(name: &'static str, threads: usize) -> Result<rayon::ThreadPool> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .thread_name(move |index| format!("{name}-{index}"))
        .build()
        .map_err(|error| Error::Threads {
            threads,
            reason: error.to_string(),
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threads_are_counted_and_named() {
        let three = pool("work", 3).unwrap();
        assert_eq!(three.current_num_threads(), 3);
        let names = three.broadcast(|_| std::thread::current().name().map(str::to_owned));
        let names: Vec<_> = names.iter().map(Option::as_deref).collect();
        assert_eq!(names, [Some("work-0"), Some("work-1"), Some("work-2")]);
        assert!(pool("work", 0).unwrap().current_num_threads() > 0);
    }
}
