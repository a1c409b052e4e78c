//! A thread that answers the newest question. Whoever asks never waits: a question that has not been
//! taken up when the next one comes is dropped, and so is an answer that nobody has fetched.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// Storage for one value; a newer one takes its place.
struct Mailbox<T> {
    slot: Mutex<Slot<T>>,
    changed: Condvar,
}

struct Slot<T> {
    value: Option<T>,
    closed: bool,
}

impl<T> Mailbox<T> {
    fn new() -> Arc<Self> {
        Arc::new(Self {
            slot: Mutex::new(Slot {
                value: None,
                closed: false,
            }),
            changed: Condvar::new(),
        })
    }

    fn lock(&self) -> MutexGuard<'_, Slot<T>> {
        // The lock is only ever held to move a value: there is nothing a panic could leave half-done.
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn put(&self, value: T) {
        self.lock().value = Some(value);
        self.changed.notify_one();
    }

    /// What is there now.
    fn take(&self) -> Option<T> {
        self.lock().value.take()
    }

    /// Waits for the next value; none once the mailbox is closed.
    fn wait(&self) -> Option<T> {
        let mut slot = self.lock();
        loop {
            if slot.closed {
                return None;
            }
            if let Some(value) = slot.value.take() {
                return Some(value);
            }
            slot = self
                .changed
                .wait(slot)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_one();
    }
}

/// A worker that turns questions into answers. Its thread ends after the work in hand when this is dropped.
pub struct Newest<Q, A> {
    questions: Arc<Mailbox<Q>>,
    answers: Arc<Mailbox<A>>,
}

impl<Q: Send + 'static, A: Send + 'static> Newest<Q, A> {
    /// Starts the thread `name`.
    ///
    /// # Errors
    /// When the thread cannot be started.
    pub fn spawn(
        name: &str,
        mut work: impl FnMut(Q) -> A + Send + 'static,
    ) -> std::io::Result<Self> {
        let (questions, answers) = (Mailbox::new(), Mailbox::new());
        let (waiting, done) = (Arc::clone(&questions), Arc::clone(&answers));
        std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(move || {
                while let Some(question) = waiting.wait() {
                    done.put(work(question));
                }
            })?;
        Ok(Self { questions, answers })
    }
}

impl<Q, A> Newest<Q, A> {
    /// Asks, in place of any question that still waits. Returns at once.
    pub fn ask(&self, question: Q) {
        self.questions.put(question);
    }

    /// The newest answer that was not fetched before; `None` if there is none. Returns at once.
    pub fn answer(&self) -> Option<A> {
        self.answers.take()
    }
}

impl<Q, A> Drop for Newest<Q, A> {
    fn drop(&mut self) {
        self.questions.close();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::sync_channel;

    use super::*;

    #[test]
    fn a_busy_worker_skips_to_the_newest_question_and_nobody_waits_for_it() {
        // The work tells what it took up, then stays busy until it is let go.
        let (began_tx, began) = sync_channel(8);
        let (go, go_rx) = sync_channel::<()>(8);
        let worker = Newest::spawn("test", move |question: u32| {
            began_tx.send(question).expect("the test listens");
            go_rx.recv().expect("the test lets go");
            10 * question
        })
        .expect("a thread");
        worker.ask(1);
        assert_eq!(began.recv(), Ok(1));
        for question in 2..=1000 {
            worker.ask(question);
            assert_eq!(worker.answer(), None);
        }
        go.send(()).expect("the worker lives");
        // Taking up the next question means that the first answer is there.
        assert_eq!(began.recv(), Ok(1000));
        assert_eq!(worker.answer(), Some(10));
        assert_eq!(worker.answer(), None);
        go.send(()).expect("the worker lives");
        worker.ask(1001);
        assert_eq!(began.recv(), Ok(1001));
        assert_eq!(worker.answer(), Some(10_000));
        // Dropped while busy: the thread ends once it is let go, which closes its channel.
        drop(worker);
        go.send(()).expect("the worker lives");
        assert!(began.recv().is_err());
    }

    #[test]
    fn a_closed_mailbox_hands_out_nothing_more() {
        let mailbox = Mailbox::new();
        mailbox.put(1);
        mailbox.put(2);
        assert_eq!(mailbox.wait(), Some(2));
        mailbox.put(3);
        mailbox.close();
        assert_eq!(mailbox.wait(), None);
    }
}
