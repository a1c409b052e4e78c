//! Work whose answer the window awaits: a promise that a service gives, the worker's end of it, and where a screen
//! keeps it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};

/// How far a [`Job`] is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stage {
    /// What is being done: a few words.
    pub what: String,
    /// Share done, 0..1, if it is known.
    pub share: Option<f32>,
}

#[derive(Default)]
struct Shared {
    stage: Mutex<Stage>,
    cancelled: AtomicBool,
}

/// Work that goes on elsewhere: how far it is, a way to stop it, one answer. Dropping it cancels it.
pub struct Job<T> {
    shared: Arc<Shared>,
    answer: Receiver<Result<T, String>>,
}

/// The worker's end of a [`Job`].
pub struct Worker<T> {
    shared: Arc<Shared>,
    answer: SyncSender<Result<T, String>>,
}

impl<T> Job<T> {
    /// A job and its worker's end.
    pub fn pair() -> (Self, Worker<T>) {
        let (tx, answer) = sync_channel(1);
        let shared = Arc::new(Shared::default());
        let worker = Worker {
            shared: Arc::clone(&shared),
            answer: tx,
        };
        (Self { shared, answer }, worker)
    }

    /// An answer that is there already.
    pub fn ready(answer: Result<T, String>) -> Self {
        let (job, worker) = Self::pair();
        worker.finish(answer);
        job
    }

    /// The answer, once; a worker that vanished counts as an error.
    pub fn poll(&self) -> Option<Result<T, String>> {
        match self.answer.try_recv() {
            Ok(answer) => Some(answer),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => {
                Some(Err("The work ended without an answer.".into()))
            }
        }
    }

    /// How far it is.
    pub fn stage(&self) -> Stage {
        let stage = self.shared.stage.lock();
        stage.unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl<T> Drop for Job<T> {
    fn drop(&mut self) {
        self.shared.cancelled.store(true, Ordering::Relaxed);
    }
}

impl<T> Worker<T> {
    /// Reports how far the work is.
    pub fn tell(&self, what: &str, share: Option<f32>) {
        let mut stage = self
            .shared
            .stage
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if stage.what != what {
            what.clone_into(&mut stage.what);
        }
        stage.share = share;
    }

    /// Whether nobody waits for the answer any more.
    pub fn cancelled(&self) -> bool {
        self.shared.cancelled.load(Ordering::Relaxed)
    }

    /// Gives the answer.
    pub fn finish(self, answer: Result<T, String>) {
        // The window may have given up waiting; the channel holds the one answer there is.
        let _ = self.answer.try_send(answer);
    }
}

/// A [`Job`] under way and what it is for, or nothing. Dropping it, or beginning another one, cancels the
/// work.
pub struct Pending<T, C = ()>(Option<(C, Job<T>)>);

impl<T, C> Default for Pending<T, C> {
    fn default() -> Self {
        Self(None)
    }
}

impl<T> Pending<T> {
    /// Awaits the answer of `job`.
    pub fn begin(&mut self, job: Job<T>) {
        self.begin_for((), job);
    }

    /// The answer, once it is there; nothing is awaited then.
    pub fn take(&mut self) -> Option<Result<T, String>> {
        self.take_for().map(|((), answer)| answer)
    }
}

impl<T, C> Pending<T, C> {
    /// Awaits the answer of `job`, which is for `context`.
    pub fn begin_for(&mut self, context: C, job: Job<T>) {
        self.0 = Some((context, job));
    }

    /// The answer and what it is for, once it is there; nothing is awaited then.
    pub fn take_for(&mut self) -> Option<(C, Result<T, String>)> {
        let answer = self.0.as_ref()?.1.poll()?;
        let (context, _) = self.0.take()?;
        Some((context, answer))
    }

    /// Whether an answer is awaited.
    pub fn is_busy(&self) -> bool {
        self.0.is_some()
    }

    /// What the awaited answer is for.
    pub fn context(&self) -> Option<&C> {
        self.0.as_ref().map(|(context, _)| context)
    }

    /// How far the work is.
    pub fn stage(&self) -> Option<Stage> {
        self.0.as_ref().map(|(_, job)| job.stage())
    }

    /// Awaits nothing any more.
    pub fn cancel(&mut self) {
        self.0 = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_tells_how_far_it_is_answers_once_and_notices_that_nobody_waits() {
        let (job, worker) = Job::pair();
        assert_eq!(job.poll(), None);
        worker.tell("counting", Some(0.5));
        assert_eq!(job.stage().what, "counting");
        assert!(!worker.cancelled());
        worker.finish(Ok(7));
        assert_eq!(job.poll(), Some(Ok(7)));
        let (job, worker) = Job::<u8>::pair();
        drop(job);
        assert!(worker.cancelled());
        let (job, worker) = Job::<u8>::pair();
        drop(worker);
        assert!(job.poll().is_some_and(|a| a.is_err()));
    }

    #[test]
    fn an_answer_is_taken_once_with_what_it_is_for_and_another_job_cancels_the_first() {
        let mut pending = Pending::<u8, &str>::default();
        assert!(!pending.is_busy() && pending.take_for().is_none());
        let (first, worker) = Job::pair();
        pending.begin_for("first", first);
        worker.tell("counting", Some(0.5));
        assert_eq!(pending.context(), Some(&"first"));
        assert_eq!(pending.stage().and_then(|s| s.share), Some(0.5));
        assert!(pending.take_for().is_none() && pending.is_busy());
        let (second, other) = Job::pair();
        pending.begin_for("second", second);
        assert!(worker.cancelled() && !other.cancelled());
        other.finish(Ok(7));
        assert_eq!(pending.take_for(), Some(("second", Ok(7))));
        assert!(!pending.is_busy() && pending.take_for().is_none());
    }
}
