// SPDX-License-Identifier: MIT
// All that a rollout takes beside the state path: many steps of one doorbell, whose actions the policy engine chooses,
// and what becomes of the episodes.
//
// Of each step, groups pass the state path twice. First they show what the step starts from, which changes nothing:
// where an episode has ended, that is the start of the next one. What is seen goes to the policy engine. Then they
// are stepped with its actions, as they would be by a doorbell of their own.
module pearl_rollout
  import pearl_pkg::*;
  import pearl_core_pkg::*;
  import pearl_engine_pkg::*;
#(
    parameter int unsigned GROUPS = 4,
    parameter int unsigned PE_NUM = 4,
    parameter int unsigned DATA_WL = 32,
    // Cycles from one group to the next, and from a group's issue to its results.
    parameter int unsigned INTERVAL = 1,
    parameter int unsigned DEPTH = 8,
    localparam int unsigned GROUP_BITS = index_bits(GROUPS)
) (
    input logic clk_i,
    input logic rst_ni,

    // Writes of the policy, and READ_LATENCY cycles after the index what the statistics have there.
    input  logic                         policy_we_i,
    input  logic [POLICY_INDEX_BITS-1:0] host_index_i,
    input  logic [                 31:0] host_wdata_i,
    output logic [          DATA_WL-1:0] statistics_o,

    // The doorbell, and from the next cycle on what it is for.
    input  logic         ring_i,
    input  mode_t        mode_i,
    input  logic  [31:0] steps_i,
    input  logic  [31:0] first_slot_i,
    // The sequencer begins a step, and is done with it, which is the last one of the doorbell; when it has to
    // begin another one, and that there is one to come.
    input  logic         start_i,
    input  logic         done_i,
    output logic         last_step_o,
    output logic         rollout_o,
    output mode_t        mode_o,
    output logic         ring_o,
    output logic         between_o,
    output logic  [31:0] cycles_o,

    input  logic              keys_stale_i,
    input  logic              keys_next_i,
    input  logic [ 1:0][31:0] seed_i,
    input  logic [63:0]       tick_i,
    output logic              keys_valid_o,

    // A group enters the state path.
    output logic                                   issue_o,
    output logic                                   issue_last_o,
    output logic                                   issue_observe_o,
    output logic [GROUP_BITS-1:0]                  issue_group_o,
    output logic [          31:0]                  issue_slot_o,
    output logic [    PE_NUM-1:0][ACTION_BITS-1:0] actions_o,

    // It comes out.
    input  logic                                    valid_i,
    input  logic                                    last_i,
    input  logic                                    observe_i,
    input  logic [GROUP_BITS-1:0]                   group_i,
    input  logic [    PE_NUM-1:0][    OBS_BITS-1:0] obs_i,
    input  logic [    PE_NUM-1:0][ REWARD_BITS-1:0] rewards_i,
    input  logic [    PE_NUM-1:0][    TER_BITS-1:0] ters_i,
    input  logic [    PE_NUM-1:0][      AGENTS-1:0] gone_i,
    input  logic [    PE_NUM-1:0][ELAPSED_BITS-1:0] elapsed_i,
    // All of the step have.
    output logic                                    counted_o
);

  // Groups that may be under way: two batches of a network; else as many as fill the way there and back.
  localparam bit LAYERED = ENGINE == NetworkEngine || ENGINE == PlanesEngine;
  localparam int unsigned WAY = ENGINE == GoldenEngine ? ACT_LATENCY : 2 * ACTIONS;
  localparam int unsigned WAY_CREDITS = 1 << $clog2(DEPTH + WAY + 48);
  localparam int unsigned CREDITS = LAYERED ? 2 * SIDE * ROUNDS : WAY_CREDITS;
  localparam int unsigned OBSERVE_II = LAYERED ? ceil_div(INPUTS, PRODUCTS) : 1;

  logic [31:0] steps_done;
  logic [63:0] cycles;
  logic actions_valid, take;

  // The first step does what the doorbell says of resets.
  assign rollout_o = mode_i.rollout;
  always_comb begin
    mode_o = mode_i;
    if (rollout_o) begin
      mode_o.reset_mask = 1'b0;
      mode_o.reset_all  = mode_i.reset_all && steps_done == '0;
    end
  end

  pearl_repeater u_repeater (
      .clk_i,
      .rst_ni,
      .ring_i,
      .rollout_i(rollout_o),
      .steps_i,
      .done_i,
      .last_o   (last_step_o),
      .ring_o,
      .between_o,
      .steps_o  (steps_done),
      .cycles_o (cycles)
  );
  assign cycles_o = cycles[31:0];

  pearl_rollout_reader #(
      .GROUPS    (GROUPS),
      .PE_NUM    (PE_NUM),
      .II        (INTERVAL),
      .OBSERVE_II(OBSERVE_II),
      .CREDITS   (CREDITS)
  ) u_reader (
      .clk_i,
      .rst_ni,
      .start_i        (start_i && rollout_o),
      .first_slot_i,
      .actions_valid_i(actions_valid),
      .issue_o,
      .observe_o      (issue_observe_o),
      .group_o        (issue_group_o),
      .last_o         (issue_last_o),
      .slot_o         (issue_slot_o)
  );
  assign take = issue_o && !issue_observe_o;

  // Agents that have ended see nothing.
  logic [PE_NUM-1:0][AGENTS-1:0][AGENT_OBS_BITS-1:0] seen;
  for (genvar pe = 0; pe < PE_NUM; pe++) begin : gen_pe
    for (genvar i = 0; i < AGENTS; i++) begin : gen_agent
      assign seen[pe][i] = gone_i[pe][i] ? '0 : obs_i[pe][i*AGENT_OBS_BITS+:AGENT_OBS_BITS];
    end
  end

  logic chosen_valid;
  logic [PE_NUM-1:0][ACTION_BITS-1:0] chosen;

  if (ENGINE == GoldenEngine) begin : gen_golden
    pearl_golden #(
        .PE_NUM(PE_NUM)
    ) u_golden (
        .clk_i,
        .rst_ni,
        .start_i,
        .first_slot_i,
        .restart_i(keys_stale_i),
        .next_i   (keys_next_i),
        .seed_i,
        .tick_i,
        .keys_valid_o,
        .valid_i  (valid_i && observe_i),
        .obs_i    (seen),
        .valid_o  (chosen_valid),
        .actions_o(chosen)
    );
  end else begin : gen_policy
    pearl_policy #(
        .PE_NUM (PE_NUM),
        .CREDITS(CREDITS)
    ) u_policy (
        .clk_i,
        .rst_ni,
        .we_i     (policy_we_i),
        .index_i  (host_index_i),
        .wdata_i  (host_wdata_i),
        .start_i,
        .first_slot_i,
        .restart_i(keys_stale_i),
        .next_i   (keys_next_i),
        .seed_i,
        .tick_i,
        .keys_valid_o,
        .valid_i  (valid_i && observe_i),
        .last_i,
        .obs_i    (seen),
        .valid_o  (chosen_valid),
        .actions_o(chosen)
    );
  end

  pearl_fifo #(
      .WIDTH(PE_NUM * ACTION_BITS),
      .DEPTH(at_least(2, 1 << $clog2(CREDITS)))
  ) u_actions (
      .clk_i,
      .rst_ni (rst_ni && !start_i),
      .push_i (chosen_valid),
      .data_i (chosen),
      .valid_o(actions_valid),
      .data_o (actions_o),
      .pop_i  (take)
  );

  logic at_quanta;
  logic [63:0] episodes, truncated, lengths, returns;
  assign at_quanta = host_index_i[POLICY_INDEX_BITS-1-:SECTION_BITS] == SECTION_BITS'(Quanta);

  pearl_statistics #(
      .GROUPS     (GROUPS),
      .PE_NUM     (PE_NUM),
      .AGENTS     (AGENTS),
      .REWARD_BITS(AGENT_REWARD_BITS),
      .TABLED     (REWARD_TABLED),
      .SIGNED     (REWARD_SIGNED),
      .INDEX_BITS (POLICY_INDEX_BITS - SECTION_BITS)
  ) u_statistics (
      .clk_i,
      .rst_ni,
      .we_i       (policy_we_i && at_quanta),
      .index_i    (host_index_i[POLICY_INDEX_BITS-SECTION_BITS-1:0]),
      .wdata_i    (host_wdata_i),
      .clear_i    (ring_i),
      .start_i,
      .steps_i    (steps_done),
      .valid_i    (valid_i && !observe_i),
      .last_i,
      .group_i,
      .rewards_i,
      .ters_i,
      .gone_i,
      .elapsed_i,
      .done_o     (counted_o),
      .episodes_o (episodes),
      .truncated_o(truncated),
      .lengths_o  (lengths),
      .returns_o  (returns)
  );

  // ---- The host's words ----

  localparam int unsigned STATISTICS_BITS = stream_words(STATISTICS_WORDS, 32, DATA_WL) * DATA_WL;
  localparam int unsigned WORDS = STATISTICS_BITS / DATA_WL;
  localparam int unsigned WORD_BITS = index_bits(WORDS);

  logic [STATISTICS_BITS-1:0] words;
  logic [WORD_BITS-1:0] word_q;
  logic [DATA_WL-1:0] word;

  // Behind the sums, what the engine is.
  assign words = STATISTICS_BITS'({
    FILTERS,
    VALUE_BITS,
    WEIGHT_BITS,
    LAYERS,
    HIDDEN,
    ROUNDS,
    SIDE,
    PRODUCTS,
    LOGIT_BITS,
    TABLE_ROWS,
    ACT_NUMBER,
    DRAWN,
    returns,
    lengths,
    truncated,
    episodes,
    cycles,
    32'h0,
    steps_done
  });
  always_ff @(posedge clk_i) word_q <= host_index_i[WORD_BITS-1:0];
  always_comb begin
    word = '0;
    for (int unsigned i = 0; i < WORDS; i++) begin
      if (32'(word_q) == i) word = words[i*DATA_WL+:DATA_WL];
    end
  end

  pearl_delay #(
      .WIDTH (DATA_WL),
      .STAGES(READ_LATENCY - 1)
  ) u_read (
      .clk_i,
      .d_i(word),
      .d_o(statistics_o)
  );

endmodule
