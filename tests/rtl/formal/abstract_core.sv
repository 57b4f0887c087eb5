// SPDX-License-Identifier: MIT
// A core that may answer anything, as long as it keeps its latency: its other outputs are driven by nothing,
// and what nothing drives is free.
module pearl_core
  import pearl_core_pkg::*;
(
    input  logic                         clk_i,
    input  logic                         rst_ni,
    input  logic                         valid_i,
    input  logic                         first_i,
    input  logic                         hold_i,
    input  logic [ STATE_BITS-1:0]       state_i,
    input  logic [ACTION_BITS-1:0]       action_i,
    input  logic [  RNG_WORDS-1:0][31:0] rng_i,
    output logic                         valid_o,
    output logic [ STATE_BITS-1:0]       state_o,
    output logic [   OBS_BITS-1:0]       obs_o,
    output logic [REWARD_BITS-1:0]       reward_o,
    output logic [     AGENTS-1:0]       terminated_o
);

  logic [LATENCY-1:0] valid_q;
  always_ff @(posedge clk_i) begin
    if (!rst_ni) valid_q <= '0;
    else valid_q <= LATENCY'({valid_q, valid_i});
  end
  assign valid_o = valid_q[LATENCY-1];

endmodule
