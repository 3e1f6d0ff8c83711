//! Data for a recording, from this process's machine or from another process's.
//!
//! Invariant: a follower that is too slow loses the oldest news and is told how many; the owner's machine never waits
//! for a follower.

use super::account::Account;
use super::{Client, Failure, Machine, NoNews, Subscription};
use etherpen::messages::Welcome;
use std::time::Duration;

/// Source of accounts.
#[derive(Debug)]
pub enum Source {
    /// This process's machine.
    Own(Machine, Subscription),
    /// Another process's machine.
    Shared(Client),
}

impl Source {
    /// Follows another process's machine: everything that is recorded arrives from now on.
    ///
    /// # Errors
    /// The owner has ended.
    pub fn follow(mut client: Client) -> Result<Self, Failure> {
        client.begin_following()?;
        Ok(Self::Shared(client))
    }

    /// The firmware connected to this process's own machine.
    pub fn welcome(&self) -> Option<Welcome> {
        match self {
            Self::Own(machine, _) => machine.snapshot().welcome,
            Self::Shared(_) => None,
        }
    }

    /// The oldest account; waits for it at most `longest`.
    ///
    /// # Errors
    /// [`NoNews`]; closed when the owner has ended.
    pub fn next_within(&mut self, longest: Duration) -> Result<Account, NoNews> {
        match self {
            Self::Own(_, news) => match news.take_lost() {
                0 => Account::of(&news.next_within(longest)?).ok_or(NoNews::Timeout),
                lost => Ok(Account::Missed(lost)),
            },
            Self::Shared(client) => client.next_account(longest),
        }
    }
}
