"""From logged runs to tables and figures; reads run folders only."""
