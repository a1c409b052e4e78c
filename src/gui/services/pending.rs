//! Work whose answer the window awaits.

use super::{Job, Stage};

/// A [`Job`] under way and what it is for, or nothing. Dropping it, or beginning another one, tells the worker
/// that nobody waits any more.
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
