//! Progress of long work, for whoever shows it.

/// Receives the progress of long work: stages of items; an item may consist of trials.
pub trait Progress: Send + Sync {
    /// A stage begins, with `items` items to do.
    fn stage(&self, name: &str, items: usize);

    /// An item is done.
    fn item_done(&self);

    /// `count` items of the stage are done in all.
    fn items_done(&self, count: usize) {
        let _ = count;
    }

    /// `count` trials begin: those of the present item, or of all items of the stage.
    fn trials(&self, count: usize) {
        let _ = count;
    }

    /// A trial is done.
    fn trial_done(&self) {}

    /// The stage is done; `result` is its result in words.
    fn stage_done(&self, result: &str);
}

/// Progress that nobody reads.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Progress for Silent {
    fn stage(&self, _name: &str, _items: usize) {}
    fn item_done(&self) {}
    fn stage_done(&self, _result: &str) {}
}
