//! Point clouds.

use std::path::Path;

use crate::cloud::Cloud;
use crate::columns::Columns;
use crate::error::{Error, Result};

use super::body::Body;
use super::header::Header;

/// Parses a PLY point cloud (the vertices of the file); `path` is for messages.
///
/// # Errors
/// Names the file, and the vertex or the header's line, and what is wrong.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<Cloud> {
    let header = Header::parse(path, bytes)?;
    let mut body = Body::new(path, bytes, &header)?;
    for element in &header.elements {
        if element.name != "vertex" {
            body.element(element, |_| Ok(()), |_, _| Ok(()))?;
            continue;
        }
        let properties = element.properties.iter();
        // A list is no column: it gets a name that none has.
        let fields: Vec<_> = properties
            .map(|p| (p.list.map_or(p.name.as_str(), |_| ""), p.scalar))
            .collect();
        let mut columns = Columns::pick(path, &fields)?;
        let row = |values: &[f64]| {
            columns.each().for_each(|(field, _, column)| column.push(values[field]));
            Ok(())
        };
        body.element(element, row, |_, _| Ok(()))?;
        return columns.into_cloud(path);
    }
    Err(Error::format(path, "has no vertices"))
}
