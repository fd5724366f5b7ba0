//! The clusters of one bake: those that no helper can cut are counted, with why, and left to the caller's own method.

use super::fault::HelperFault;
use super::pool::Pool;
use super::wire::{Options, Request};
use pb_mesh::charts::{Charts, ClusterSurface};
use serde::Serialize;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Most faults that a summary tells; all are counted.
pub const MAX_TOLD_FAULTS: usize = 3;

/// What the helper did, for reports.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct HelperSummary {
    /// Clusters with charts of the helper.
    pub by_helper: u64,
    /// Clusters that it could not cut.
    pub by_fallback: u64,
    /// Why: the first different reasons, at most [`MAX_TOLD_FAULTS`], sorted.
    pub faults: Vec<String>,
}

/// Charts by the helper program, asked from many threads.
pub struct HelperCharts {
    pool: Result<Pool, HelperFault>,
    limit: Duration,
    summary: Mutex<HelperSummary>,
}

impl HelperCharts {
    /// With a time `limit` for each cluster. Where there is no `pool`, its fault is that of every cluster.
    pub fn new(pool: Result<Pool, HelperFault>, limit: Duration) -> HelperCharts {
        HelperCharts { pool, limit, summary: Mutex::new(HelperSummary::default()) }
    }

    /// Charts of a cluster, checked; `None` where the helper has none.
    pub fn charts(&self, surface: &ClusterSurface) -> Option<Charts> {
        let request = Request {
            time_limit_ms: u32::try_from(self.limit.as_millis()).unwrap_or(u32::MAX),
            options: Options::default(),
            positions: surface.positions.to_vec(),
            triangles: surface.triangles.to_vec(),
        };
        let answer = match &self.pool {
            Ok(pool) => pool.charts(&request, self.limit).map_err(|fault| fault.to_string()),
            Err(fault) => Err(fault.to_string()),
        };
        let mut summary = self.summary.lock().unwrap_or_else(PoisonError::into_inner);
        match answer {
            Ok(charts) => {
                summary.by_helper += 1;
                let mirrored = vec![false; charts.count as usize];
                Some(Charts { chart_of: charts.chart_of, count: charts.count, uv: charts.uv, mirrored })
            }
            Err(fault) => {
                summary.by_fallback += 1;
                if summary.faults.len() < MAX_TOLD_FAULTS && !summary.faults.contains(&fault) {
                    summary.faults.push(fault);
                }
                None
            }
        }
    }

    /// What came of all clusters. Ends the helpers.
    pub fn summary(self) -> HelperSummary {
        let mut summary = self.summary.into_inner().unwrap_or_else(PoisonError::into_inner);
        summary.faults.sort();
        summary
    }
}
