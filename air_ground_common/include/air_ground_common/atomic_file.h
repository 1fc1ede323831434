// Files that are either whole or not there.
#pragma once

#include <functional>
#include <ostream>
#include <string>

namespace air_ground_common {

/// `body` writes to the stream it gets. Goes through a file of a name of its own beside `path`, which is flushed to the
/// disk before it takes the place of the old one: an interrupted write, or a power cut, leaves the old file whole, and
/// two writers do not mix. `begins_with`, unless empty: an existing file that begins otherwise is not of this kind and
/// is not overwritten. Throws std::runtime_error, with the system's reason.
void writeAtomically(const std::string& path, const std::function<void(std::ostream&)>& body,
                     const std::string& begins_with = "");

/// Throws std::runtime_error for what writeAtomically would not overwrite with `begins_with`; whoever takes long to
/// make the content asks before.
void refuseOtherKind(const std::string& path, const std::string& begins_with);

}  // namespace air_ground_common
