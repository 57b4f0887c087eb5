// SPDX-License-Identifier: MIT
// The policy engine for a golden function: observations of groups go in, rows of their actions come out, in the same
// order. A group a cycle.
//
// The function is a part of the design: there is a generated core of it, pearl_act, for every agent of a group.
module pearl_golden
  import pearl_pkg::*;
  import pearl_core_pkg::*;
  import pearl_engine_pkg::*;
#(
    parameter int unsigned PE_NUM = 4
) (
    input logic clk_i,
    input logic rst_ni,

    // A step begins, with the slot that is its first.
    input  logic              start_i,
    input  logic [31:0]       first_slot_i,
    // As pearl_draws has them.
    input  logic              restart_i,
    input  logic              next_i,
    input  logic [ 1:0][31:0] seed_i,
    input  logic [63:0]       tick_i,
    output logic              keys_valid_o,

    input logic                            valid_i,
    input logic [PE_NUM-1:0][OBS_BITS-1:0] obs_i,

    output logic                               valid_o,
    output logic [PE_NUM-1:0][ACTION_BITS-1:0] actions_o
);

  localparam int unsigned ROWS = PE_NUM * AGENTS;
  localparam int unsigned AGENT_ACTION_BITS = ACTION_BITS / AGENTS;
  // Words of draws of an agent and of a slot, at least 1 since a port cannot have none.
  localparam int unsigned WORDS = at_least(1, ACT_DRAWS);
  localparam int unsigned SLOT_WORDS = at_least(1, AGENTS * ACT_DRAWS);
  // Observations wait for their draws, or else for a cycle, so that what comes from a core goes into another one
  // through a register.
  localparam int unsigned WAITS = ACT_DRAWS == 0 ? 1 : DRAW_LATENCY;

  // ---- Random numbers, of agents in their order ----

  logic [31:0] slot_q;
  logic [PE_NUM-1:0][SLOT_WORDS-1:0][31:0] draws;

  always_ff @(posedge clk_i) begin
    if (start_i) slot_q <= first_slot_i;
    else if (valid_i) slot_q <= slot_q + 32'(PE_NUM);
  end

  pearl_draws #(
      .PE_NUM(PE_NUM),
      .DRAWS (AGENTS * ACT_DRAWS),
      .FIRST (POLICY_DRAW)
  ) u_draws (
      .clk_i,
      .rst_ni,
      .restart_i,
      .next_i,
      .seed_i,
      .tick_i,
      .valid_o(keys_valid_o),
      .slot_i (slot_q),
      .draws_o(draws)
  );

  logic [WAITS:1] valid_q;
  logic [PE_NUM-1:0][OBS_BITS-1:0] obs;

  always_ff @(posedge clk_i) begin
    if (!rst_ni) valid_q <= '0;
    else valid_q <= WAITS'({valid_q, valid_i});
  end

  pearl_delay #(
      .WIDTH (PE_NUM * OBS_BITS),
      .STAGES(WAITS)
  ) u_obs (
      .clk_i,
      .d_i(obs_i),
      .d_o(obs)
  );

  // ---- Actions ----

  logic [ROWS-1:0] valids;
  assign valid_o = valids[0];
  // All come together.
  logic unused_valids;
  assign unused_valids = ^valids;

  for (genvar i = 0; i < ROWS; i++) begin : gen_act
    logic [WORDS-1:0][31:0] own;
    assign own = draws[i/AGENTS][i%AGENTS*ACT_DRAWS+:WORDS];

    pearl_act u_act (
        .clk_i,
        .rst_ni,
        .valid_i (valid_q[WAITS]),
        .obs_i   (obs[i/AGENTS][i%AGENTS*AGENT_OBS_BITS+:AGENT_OBS_BITS]),
        .rng_i   (own),
        .valid_o (valids[i]),
        .action_o(actions_o[i/AGENTS][i%AGENTS*AGENT_ACTION_BITS+:AGENT_ACTION_BITS])
    );
  end

endmodule
