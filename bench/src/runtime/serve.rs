//! The other process: loads one model and runs it on what it is given, until its input ends.

use std::{
    fs::File,
    io::{self, Write},
    path::Path,
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    time::Instant,
};

use strat_store::guard::guarded;

use super::{
    Device, Runtime, RuntimeChoice, Session,
    process::{Answer, Ask, Started, frame},
};

/// Something is being done for the other end.
static BUSY: AtomicBool = AtomicBool::new(true);

/// Loads a model and answers requests from stdin on stdout, both of which belong to the process that
/// has started this one.
///
/// # Errors
/// The other end is gone.
pub fn serve(
    choice: RuntimeChoice,
    model: &Path,
    device: Device,
    threads: usize,
) -> io::Result<()> {
    let mut answers = answers()?;
    let (sender, requests) = mpsc::sync_channel(1);
    std::thread::spawn(move || {
        while let Ok(Some(request)) = frame::read::<Ask>(&mut io::stdin().lock()) {
            BUSY.store(true, Ordering::SeqCst);
            if sender.send(request).is_err() {
                return;
            }
        }
        // The other end is gone, and a model may run for ever.
        if BUSY.load(Ordering::SeqCst) {
            std::process::abort();
        }
    });
    let loaded = Runtime::resolve(choice, device)
        .and_then(|(runtime, _)| runtime.load(model, device, threads));
    let mut session = match loaded {
        Ok(session) => session,
        Err(error) => {
            return frame::write(&mut answers, &Started::Refused(error.to_string()), &[]);
        }
    };
    let ready = Started::Ready {
        runtime: session.runtime().to_owned(),
        provider: session.provider().to_owned(),
        placement: session.placement().to_vec(),
    };
    BUSY.store(false, Ordering::SeqCst);
    frame::write(&mut answers, &ready, &[])?;
    for (ask, values) in requests {
        let (answer, output) = answer(&mut session, &ask, &values);
        BUSY.store(false, Ordering::SeqCst);
        frame::write(&mut answers, &answer, &output)?;
    }
    Ok(())
}

fn answer(session: &mut Session, ask: &Ask, values: &[f32]) -> (Answer, Vec<f32>) {
    let started = Instant::now();
    let outputs = guarded("the runtime", || {
        fault();
        session.run(&ask.input, ask.shape, values, &ask.wanted)
    });
    let mut outputs = match outputs.map(|run| run.map_err(|error| error.to_string())) {
        Ok(Ok(outputs)) => outputs,
        Ok(Err(reason)) | Err(reason) => return (Answer::Failed(reason), Vec::new()),
    };
    let run = started.elapsed();
    let wanted = outputs.iter_mut().find(|output| output.name == ask.wanted);
    let data = wanted.map_or(Vec::new(), |output| std::mem::take(&mut output.data));
    if data.len() as u64 > frame::MOST_VALUES {
        let reason = format!(
            "the model's output `{}` has {} values; at most {} are read",
            ask.wanted,
            data.len(),
            frame::MOST_VALUES
        );
        return (Answer::Failed(reason), Vec::new());
    }
    let all = outputs
        .into_iter()
        .map(|output| (output.name, output.shape))
        .collect();
    (Answer::Outputs { all, run }, data)
}

/// What the other end reads; whatever a runtime prints goes elsewhere.
#[cfg(unix)]
fn answers() -> io::Result<impl Write> {
    use std::os::fd::AsFd as _;
    let answers = File::from(io::stdout().as_fd().try_clone_to_owned()?);
    nix::unistd::dup2_stdout(io::stderr())?;
    Ok(answers)
}

#[cfg(not(unix))]
fn answers() -> io::Result<impl Write> {
    Ok(io::stdout())
}

/// Goes wrong at a chosen request of a debug build, as a runtime may: `abort@3` or `panic@3` in the
/// environment variable `STRAT_MODEL_FAULT`, for tests.
fn fault() {
    #[cfg(debug_assertions)]
    {
        use std::sync::atomic::AtomicUsize;
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed) + 1;
        let chosen = std::env::var("STRAT_MODEL_FAULT").unwrap_or_default();
        match chosen.split_once('@') {
            Some((_, at)) if at.parse() != Ok(count) => {}
            Some(("abort", _)) => std::process::abort(),
            Some(("panic", _)) => panic!("a fault for a test"),
            _ => {}
        }
    }
}
