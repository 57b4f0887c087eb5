"""What everything stands on: files, the cache folder, compiled code, calls that signals do not interrupt."""
