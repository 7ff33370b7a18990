//! Items made ahead of time by threads, taken in order.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};

/// Makes the items `0..count` on threads of its own, never more than two for each thread ahead of the
/// one that is taken.
pub struct Prefetch<T> {
    make: Arc<dyn Fn(usize) -> T + Send + Sync>,
    pool: rayon::ThreadPool,
    ahead: VecDeque<Receiver<T>>,
    begun: usize,
    count: usize,
}

impl<T: Send + 'static> Prefetch<T> {
    /// Begins with the first items.
    ///
    /// # Errors
    /// The system does not start the threads.
    pub fn new(
        threads: usize,
        count: usize,
        make: impl Fn(usize) -> T + Send + Sync + 'static,
    ) -> strat_store::Result<Self> {
        let mut prefetch = Self {
            make: Arc::new(make),
            pool: strat_store::threads::pool("strat", threads)?,
            ahead: VecDeque::new(),
            begun: 0,
            count,
        };
        for _ in 0..2 * prefetch.pool.current_num_threads() {
            prefetch.begin();
        }
        Ok(prefetch)
    }

    fn begin(&mut self) {
        if self.begun == self.count {
            return;
        }
        let (index, make) = (self.begun, Arc::clone(&self.make));
        let (sender, receiver) = sync_channel(1);
        // Nobody waits for it if the iteration has ended.
        self.pool.spawn(move || {
            let _ = sender.send(make(index));
        });
        self.ahead.push_back(receiver);
        self.begun += 1;
    }

    /// The next item; `None` behind the last, or where making it has panicked.
    pub fn take(&mut self) -> Option<T> {
        let next = self.ahead.pop_front()?;
        self.begin();
        next.recv().ok()
    }
}
