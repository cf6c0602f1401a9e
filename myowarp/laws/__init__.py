"""Laws of muscles, paths and forces, as functions of a device that know no model and no engine."""
