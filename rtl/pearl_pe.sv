// SPDX-License-Identifier: MIT
// One processing element: a core and what every environment needs around it, which is self-reset,
// the two reset modes, the count of elapsed steps and the time limit.
//
// Inputs come with valid_i, rng_i a cycle later, elapsed_i LATENCY cycles later, and results LATENCY + 1
// cycles later.
module pearl_pe
  import pearl_pkg::*;
  import pearl_core_pkg::*;
(
    input logic                           clk_i,
    input logic                           rst_ni,
    input logic                           valid_i,
    input mode_t                          mode_i,
    // Only show what this step starts from: nobody writes the other results.
    input logic                           observe_i,
    // Whether there is a time limit, and the last step that it allows, counted from 0.
    input logic                           limited_i,
    input logic  [ELAPSED_BITS-1:0]       limit_i,
    input logic  [  STATE_BITS-1:0]       state_i,
    // {truncated, who has ended} after the slot's previous step.
    input logic  [    TER_BITS-1:0]       ter_i,
    input logic  [  STATE_BITS-1:0]       init_i,
    input logic                           reset_i,
    input logic  [ ACTION_BITS-1:0]       action_i,
    input logic  [   RNG_WORDS-1:0][31:0] rng_i,

    input  logic [ELAPSED_BITS-1:0] elapsed_i,
    output logic [ELAPSED_BITS-1:0] elapsed_o,

    output logic                   valid_o,
    output logic [ STATE_BITS-1:0] state_o,
    output logic [   OBS_BITS-1:0] obs_o,
    output logic [REWARD_BITS-1:0] reward_o,
    output logic [   TER_BITS-1:0] ter_o,
    // Agents that had ended before this step.
    output logic [     AGENTS-1:0] gone_o
);

  logic named, ended, first;
  // What chooses the actions does not matter here.
  logic unused_rollout;
  assign unused_rollout = mode_i.rollout;
  assign named = mode_i.reset_all || (mode_i.reset_mask && reset_i);
  // A slot has ended when all its agents have.
  assign ended = ter_i[AGENTS] || &ter_i[AGENTS-1:0];
  assign first = named || ended;

  // A stored start state replaces the current one here, so a core knows of one kind of start only.
  logic valid_q, first_q, start_q, hold_q;
  logic [ STATE_BITS-1:0] state_q;
  logic [ACTION_BITS-1:0] action_q;
  always_ff @(posedge clk_i) begin
    first_q  <= first;
    start_q  <= first && !mode_i.stored;
    hold_q   <= observe_i || (mode_i.next_step && ended && !named);
    state_q  <= first && mode_i.stored ? init_i : state_i;
    action_q <= action_i;
  end
  always_ff @(posedge clk_i) begin
    if (!rst_ni) valid_q <= 1'b0;
    else valid_q <= valid_i;
  end

  logic [AGENTS-1:0] terminated;
  logic [REWARD_BITS-1:0] reward;
  pearl_core u_core (
      .clk_i,
      .rst_ni,
      .valid_i     (valid_q),
      .first_i     (start_q),
      .hold_i      (hold_q),
      .state_i     (state_q),
      .action_i    (action_q),
      .rng_i,
      .valid_o,
      .state_o,
      .obs_o,
      .reward_o    (reward),
      .terminated_o(terminated)
  );

  // The counter is read, raised and written while the core ends, which spares the pipeline from carrying
  // it along.
  logic first_late, hold_late, held_q, truncated_q, brief_q;
  logic [ELAPSED_BITS-1:0] elapsed_q;
  pearl_delay #(
      .WIDTH (2),
      .STAGES(LATENCY - 1)
  ) u_delay (
      .clk_i,
      .d_i({first_q, hold_q}),
      .d_o({first_late, hold_late})
  );

  // Whether a first step is also the last. The limit is there long before.
  always_ff @(posedge clk_i) brief_q <= limited_i && limit_i == '0;

  // The first step of an episode overrules the sum and the comparison instead of clearing what they
  // start from: a mask in front of them would cost a LUT a bit more. Who is held is at a first step.
  always_ff @(posedge clk_i) begin
    elapsed_q <= first_late ? ELAPSED_BITS'(!hold_late) : elapsed_i + 1'b1;
    held_q <= hold_late;
    truncated_q <= !hold_late && (first_late ? brief_q : limited_i && elapsed_i >= limit_i);
  end

  // Who had ended before this step. An only agent has never: its slot starts afresh then.
  logic [AGENTS-1:0] gone;
  if (AGENTS == 1) begin : gen_alone
    assign gone = '0;
  end else begin : gen_several
    pearl_delay #(
        .WIDTH (AGENTS),
        .STAGES(LATENCY + 1)
    ) u_gone (
        .clk_i,
        .d_i(first ? AGENTS'(0) : ter_i[AGENTS-1:0]),
        .d_o(gone)
    );
  end

  assign gone_o    = gone;
  assign elapsed_o = elapsed_q;
  assign reward_o  = held_q ? '0 : reward;
  assign ter_o     = {truncated_q, held_q ? AGENTS'(0) : gone | terminated};

endmodule
