// What the backbone has to know of the core it is built around.
//
// A build names its core by three macros: PEARL_CORE, the module; PEARL_CORE_PKG, the package that
// stands in the same file; and PEARL_CORE_OPTIONS, assignments to the module's parameters, if any.
package pearl_core_pkg;

  localparam int unsigned LATENCY = `PEARL_CORE_PKG::LATENCY;
  localparam int unsigned II = `PEARL_CORE_PKG::II;
  localparam int unsigned STATE_BITS = `PEARL_CORE_PKG::STATE_BITS;
  localparam int unsigned ACTION_BITS = `PEARL_CORE_PKG::ACTION_BITS;
  localparam int unsigned OBS_BITS = `PEARL_CORE_PKG::OBS_BITS;
  localparam int unsigned REWARD_BITS = `PEARL_CORE_PKG::REWARD_BITS;

endpackage
