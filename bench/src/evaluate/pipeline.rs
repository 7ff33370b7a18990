//! The one pipeline of this crate: prepare | run | score, overlapped.
//!
//! Items are taken in chunks. While one chunk is prepared and another is scored on rayon's threads,
//! the chunk between them goes through the network on the calling thread, which alone needs
//! `&mut`. So decoding and metrics cost no time of the network's, and no more than three chunks are
//! in memory. Results come out in the order of the items and do not depend on the number of
//! threads.
//!
//! ```
//! use std::ops::ControlFlow;
//! use strat_bench::evaluate::pipeline;
//!
//! let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build()?;
//! let (mut asked, mut sum) = (0, 0);
//! let ended: ControlFlow<&str> = pipeline::run(
//!     &["1", "2", "x"],
//!     pipeline::chunk_size(&pool),
//!     &pool,
//!     |text| text.parse::<i32>(),
//!     |_, parsed| {
//!         asked += 1;
//!         ControlFlow::Continue(parsed)
//!     },
//!     |_, parsed| parsed.map(|number| 10 * number),
//!     |_, scored| match scored {
//!         Ok(number) => {
//!             sum += number;
//!             ControlFlow::Continue(())
//!         }
//!         Err(_) => ControlFlow::Break("not a number"),
//!     },
//! );
//! assert_eq!((ended, asked, sum), (ControlFlow::Break("not a number"), 3, 30));
//! # Ok::<(), rayon::ThreadPoolBuildError>(())
//! ```
//!
//! Not here: what is done with an item that fails. A stage hands on a `Result` and `take` counts;
//! [`MAX_INITIAL_FAILURES`] is what all commands count to.

use std::ops::ControlFlow;

use rayon::prelude::*;

/// After this many failures without a single success the rest is not tried.
pub const MAX_INITIAL_FAILURES: usize = 10;

/// Items in a chunk where each one goes through a network: enough to keep all threads busy.
#[must_use]
pub fn chunk_size(pool: &rayon::ThreadPool) -> usize {
    2 * pool.current_num_threads().max(1)
}

/// Takes all `items` through three stages and hands each result to `take`.
///
/// `prepare` and `score` run on the threads of `pool`; `ask` and `take` on the calling thread, both
/// in the order of the items. Whichever of the two breaks ends the work, and its value is
/// returned; results of later items are dropped, those of earlier ones are still taken.
pub fn run<I, P, Q, R, B>(
    items: &[I],
    chunk_size: usize,
    pool: &rayon::ThreadPool,
    prepare: impl Fn(&I) -> P + Sync,
    mut ask: impl FnMut(&I, P) -> ControlFlow<B, Q>,
    score: impl Fn(&I, Q) -> R + Sync,
    mut take: impl FnMut(&I, R) -> ControlFlow<B>,
) -> ControlFlow<B>
where
    I: Sync,
    P: Send,
    Q: Send,
    R: Send,
{
    let chunks: Vec<&[I]> = items.chunks(chunk_size.max(1)).collect();
    let behind = |step: usize, by: usize| -> &[I] {
        let chunk = step.checked_sub(by).and_then(|step| chunks.get(step));
        chunk.copied().unwrap_or_default()
    };
    let (mut prepared, mut asked) = (Vec::new(), Vec::new());
    for step in 0..chunks.len() + 2 {
        let to_score = std::mem::take(&mut asked);
        let to_ask = std::mem::take(&mut prepared);
        let mut scored: Vec<R> = Vec::new();
        let mut broken = None;
        pool.in_place_scope(|scope| {
            let (prepare, score, behind) = (&prepare, &score, &behind);
            let (prepared, scored) = (&mut prepared, &mut scored);
            scope.spawn(move |_| {
                behind(step, 0)
                    .par_iter()
                    .map(prepare)
                    .collect_into_vec(prepared);
            });
            scope.spawn(move |_| {
                behind(step, 2)
                    .par_iter()
                    .zip(to_score)
                    .map(|(item, answer)| score(item, answer))
                    .collect_into_vec(scored);
            });
            for (item, ready) in behind(step, 1).iter().zip(to_ask) {
                match ask(item, ready) {
                    ControlFlow::Continue(answer) => asked.push(answer),
                    ControlFlow::Break(why) => {
                        broken = Some(why);
                        break;
                    }
                }
            }
        });
        // What was asked before the break is still scored and taken: nothing that was found is lost.
        for (item, result) in behind(step, 2).iter().zip(scored) {
            take(item, result)?;
        }
        if let Some(why) = broken {
            let mut scored = Vec::new();
            pool.install(|| {
                behind(step, 1)
                    .par_iter()
                    .zip(asked)
                    .map(|(item, answer)| score(item, answer))
                    .collect_into_vec(&mut scored);
            });
            for (item, result) in behind(step, 1).iter().zip(scored) {
                take(item, result)?;
            }
            return ControlFlow::Break(why);
        }
    }
    ControlFlow::Continue(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pool(threads: usize) -> rayon::ThreadPool {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap()
    }

    /// Takes squares of 0..count, with what each stage has seen.
    fn squares(
        count: u64,
        chunk: usize,
        threads: usize,
        ask_until: u64,
        take_until: u64,
    ) -> (ControlFlow<&'static str>, Vec<u64>, Vec<u64>) {
        let items: Vec<u64> = (0..count).collect();
        let (mut asked, mut taken) = (Vec::new(), Vec::new());
        let ended = run(
            &items,
            chunk,
            &pool(threads),
            |&item| item + 1,
            |&item, ready| {
                assert_eq!(ready, item + 1);
                if item == ask_until {
                    return ControlFlow::Break("asked");
                }
                asked.push(item);
                ControlFlow::Continue(ready - 1)
            },
            |&item, answer| item * answer,
            |&item, result| {
                assert_eq!(result, item * item);
                if item == take_until {
                    return ControlFlow::Break("taken");
                }
                taken.push(item);
                ControlFlow::Continue(())
            },
        );
        (ended, asked, taken)
    }

    #[test]
    fn every_item_goes_through_in_order() {
        for count in [0, 1, 2, 5, 7, 24] {
            for chunk in [0, 1, 3, 100] {
                for threads in [1, 4] {
                    let (ended, asked, taken) = squares(count, chunk, threads, 99, 99);
                    let all: Vec<u64> = (0..count).collect();
                    assert_eq!(ended, ControlFlow::Continue(()));
                    assert_eq!((asked, taken), (all.clone(), all));
                }
            }
        }
    }

    #[test]
    fn a_break_ends_the_work_and_no_later_result_is_taken() {
        let (ended, asked, taken) = squares(20, 3, 2, 99, 7);
        assert_eq!(ended, ControlFlow::Break("taken"));
        assert_eq!(taken, (0..7).collect::<Vec<u64>>());
        assert!(asked.len() < 20, "{asked:?}");
        let (ended, asked, taken) = squares(20, 3, 2, 7, 99);
        assert_eq!(ended, ControlFlow::Break("asked"));
        assert_eq!(asked, (0..7).collect::<Vec<u64>>());
        // Everything that was asked before is scored.
        assert_eq!(taken, (0..7).collect::<Vec<u64>>());
    }
}
