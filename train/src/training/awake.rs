//! Threads that stay awake while a step is computed.
//!
//! A pass of a small layer takes a tenth of a millisecond, and there are hundreds in a step. Between two of them the
//! threads of rayon's pool soon go to sleep, and to wake one takes some forty microseconds in a virtual machine. So the
//! others look for work in a loop for as long as a step lasts, as the threads of OpenMP and of ONNX Runtime do. What is
//! computed does not change by it.
//!
//! Not here: how work is divided ([`crate::kernels`]), and reading ahead, which has threads of its own
//! ([`crate::data::loader`]).

use std::hint::spin_loop;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use rayon::{Scope, Yield, current_num_threads, current_thread_index, yield_now};

use crate::device::DeviceChoice;

/// How long the work waits for the other threads: for some dozens to wake, and no longer, since one may be busy.
const COMING: Duration = Duration::from_millis(1);
/// Looks in vain, some tenths of a millisecond, after which a thread lets others have its processor between two looks.
const PATIENCE: u32 = 2000;

/// Does `work` on one thread of the pool; the others take what parts of it there are, and stay awake until it ends.
///
/// For work that is many short parallel passes with little between them.
pub fn keep_awake<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    let watch = Watch::default();
    rayon::scope(|scope| {
        // Ends the watch also where the work panics: the scope waits for its threads.
        let _end = EndOnDrop(&watch);
        watch.begin(scope);
        work()
    })
}

/// [`keep_awake`] where the processor computes; beside a GPU its threads would wait for nothing.
pub(crate) fn computing_on<T: Send>(
    mut devices: impl Iterator<Item = DeviceChoice>,
    work: impl FnOnce() -> T + Send,
) -> T {
    if devices.all(DeviceChoice::is_processor) {
        keep_awake(work)
    } else {
        work()
    }
}

/// What the threads of one call share.
#[derive(Default)]
struct Watch {
    /// Threads that look for parts.
    present: AtomicUsize,
    /// The work has begun; who comes now goes.
    begun: AtomicBool,
    over: AtomicBool,
}

/// Ends a watch.
struct EndOnDrop<'a>(&'a Watch);

impl Drop for EndOnDrop<'_> {
    fn drop(&mut self) {
        self.0.over.store(true, Ordering::Release);
    }
}

impl Watch {
    /// Calls the other threads, and lets those stay that come before the work begins.
    ///
    /// One that came later could come in the middle of a part that it has taken, and would wait there for the end of
    /// the work while the work waits for that part. Who has taken a part sees that the work has begun: that was
    /// written before there were parts. So whatever a thread has to finish below its watch is older than the work,
    /// and no two wait for each other, however many calls there are at the same time.
    fn begin<'scope>(&'scope self, scope: &Scope<'scope>) {
        let others = current_num_threads() - 1;
        if others == 0 {
            return;
        }
        let own = current_thread_index();
        scope.spawn_broadcast(move |_, context| {
            if Some(context.index()) != own && !self.begun.load(Ordering::Acquire) {
                self.look_for_parts();
            }
        });
        let called = Instant::now();
        while self.present.load(Ordering::Acquire) < others && called.elapsed() < COMING {
            std::thread::yield_now();
        }
        self.begun.store(true, Ordering::Release);
    }

    fn look_for_parts(&self) {
        self.present.fetch_add(1, Ordering::AcqRel);
        let mut in_vain = 0;
        while !self.over.load(Ordering::Acquire) {
            match yield_now() {
                Some(Yield::Executed) => in_vain = 0,
                _ if in_vain < PATIENCE => {
                    in_vain += 1;
                    spin_loop();
                }
                _ => std::thread::yield_now(),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use std::panic::{AssertUnwindSafe, catch_unwind};

    use rayon::prelude::*;

    /// The pool of the tests has as many threads as there are processors; this one has four anywhere.
    fn pool() -> rayon::ThreadPool {
        rayon::ThreadPoolBuilder::new()
            .num_threads(4)
            .build()
            .expect("a pool")
    }

    /// Passes in passes, as the kernels have them.
    fn passes(seed: u64) -> u64 {
        (0..200).fold(seed, |sum, pass| {
            let parts: Vec<u64> = (0..4_u64)
                .into_par_iter()
                .map(|part| (0..8_u64).into_par_iter().map(|x| x * part + pass).sum())
                .collect();
            sum + parts.iter().sum::<u64>()
        })
    }

    #[test]
    fn work_gives_what_it_gives_without() {
        let pool = pool();
        let awake = pool.install(|| keep_awake(|| passes(3)));
        assert_eq!(awake, passes(3));
    }

    #[test]
    fn calls_at_the_same_time_in_one_pool_and_within_each_other_end() {
        let pool = pool();
        let expected = passes(0);
        std::thread::scope(|scope| {
            for _ in 0..6 {
                scope.spawn(|| {
                    for _ in 0..50 {
                        let nested = || keep_awake(|| keep_awake(|| passes(0)));
                        assert_eq!(pool.install(nested), expected);
                    }
                });
            }
        });
    }

    #[test]
    fn work_that_panics_lets_the_threads_go() {
        let pool = pool();
        let spoilt = || pool.install(|| keep_awake(|| panic!("on purpose")));
        assert!(catch_unwind(AssertUnwindSafe(spoilt)).is_err());
        assert_eq!(pool.install(|| keep_awake(|| passes(1))), passes(1));
    }

    #[test]
    fn one_thread_has_nobody_to_wait_for() {
        let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build();
        let alone = alone.expect("a pool");
        assert_eq!(alone.install(|| keep_awake(|| passes(2))), passes(2));
    }
}
