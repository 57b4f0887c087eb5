// A core that may answer anything, as long as it keeps its latency. What nothing drives is free: the proof
// is of every core of these widths.
module pearl_core
  import pearl_core_pkg::*;
(
    input  logic                               clk_i,
    input  logic                               rst_ni,
    input  logic                               valid_i,
    input  logic                               first_i,
    input  logic                               hold_i,
    input  logic [ STATE_BITS-1:0]             state_i,
    input  logic [ACTION_BITS-1:0]             action_i,
    input  logic [  RNG_WORDS-1:0][31:0]       rng_i,
    output logic                               valid_o,
    output logic [ STATE_BITS-1:0]             state_o,
    output logic [   OBS_BITS-1:0]             obs_o,
    output logic [REWARD_BITS-1:0]             reward_o,
    output logic                               terminated_o
);

  pearl_delay #(
      .STAGES(LATENCY)
  ) u_valid (
      .clk_i,
      .d_i(valid_i),
      .d_o(valid_o)
  );

endmodule
