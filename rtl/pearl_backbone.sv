// SPDX-License-Identifier: MIT
// Everything but the bus: the memories and registers behind one memory port, and the pipeline that
// takes all slots through one step when the doorbell rings.
//
// pearl_top checks the sizes.
// What is on the state path is flushed, not reset. So any reset, be it a cycle long, is followed by cycles
// in which the port is busy and nothing else awake.
module pearl_backbone
  import pearl_pkg::*;
  import pearl_core_pkg::*;
  import pearl_engine_pkg::*;
  import pearl_map_pkg::*;
#(
    // Slots, processing elements and bits of a word of the address space.
    parameter int unsigned N_ENVS = 7,
    parameter int unsigned PE_NUM = 4,
    parameter int unsigned DATA_WL = 32,
    // Whether groups overlap. If not, one is read, computed and written after the other: the results
    // are the same, later.
    parameter bit PIPELINED = 1'b1,
    // Bits of a word's address; enough for the whole map.
    parameter int unsigned WORD_ADDR_BITS = 14
) (
    input logic clk_i,
    input logic rst_ni,

    // The memory port. Every request is accepted and answered PORT_LATENCY cycles later.
    input  logic                       req_i,
    input  logic                       we_i,
    // A read of a word that is to be written back with a part of it changed.
    input  logic                       fetch_i,
    input  logic  [WORD_ADDR_BITS-1:0] addr_i,
    input  logic  [       DATA_WL-1:0] wdata_i,
    output logic                       rvalid_o,
    output logic  [       DATA_WL-1:0] rdata_o,
    output resp_e                      resp_o,

    // High from the end of a step to the next doorbell.
    output logic irq_o
);

  if (LATENCY < 1 || II < 1) begin : gen_illegal_timing
    $error("the core states LATENCY %0d and II %0d; both must be at least 1", LATENCY, II);
  end

  localparam int unsigned GROUPS = ceil_div(N_ENVS, PE_NUM);
  localparam int unsigned GROUP_BITS = index_bits(GROUPS);
  localparam int unsigned MASK_WORDS = stream_words(N_ENVS, 1, DATA_WL);
  localparam int unsigned ACTION_WORDS = stream_words(N_ENVS, ACTION_BITS, DATA_WL);
  localparam int unsigned OBS_WORDS = stream_words(N_ENVS, OBS_BITS, DATA_WL);
  localparam int unsigned REWARD_WORDS = stream_words(N_ENVS, REWARD_BITS, DATA_WL);
  localparam int unsigned TER_WORDS = stream_words(N_ENVS, TER_BITS, DATA_WL);
  // Cycles from a group's issue to the packers of its results.
  localparam int unsigned DEPTH = issue_to_core(DRAWS) + LATENCY + 1;
  // From one group's issue to the next one's. Not pipelined, a group is read, computed, and written a
  // word a cycle in each bank, before the next one is issued. Only the rows of actions are fetched
  // ahead in either form.
  localparam int unsigned WIDER = OBS_BITS > REWARD_BITS ? OBS_BITS : REWARD_BITS;
  localparam int unsigned WIDEST = WIDER > TER_BITS ? WIDER : TER_BITS;
  localparam int unsigned SERIAL = DEPTH + stream_words(PE_NUM, WIDEST, DATA_WL);
  localparam int unsigned INTERVAL = PIPELINED || SERIAL < II ? II : SERIAL;
  function automatic int unsigned offset_of(int unsigned region);
    return region_offset(region, N_ENVS, PE_NUM, DATA_WL);
  endfunction

  localparam int unsigned OFFSETS[NumRegions+1] = '{
      offset_of(Control),
      offset_of(InitialStates),
      offset_of(CurrentStates),
      offset_of(Elapsed),
      offset_of(ResetMask),
      offset_of(Actions),
      offset_of(Doorbell),
      offset_of(Observations),
      offset_of(Rewards),
      offset_of(Ters),
      offset_of(Status),
      offset_of(Statistics),
      offset_of(Policy),
      offset_of(NumRegions)
  };

  // ---- Resets ----

  localparam int unsigned DRAIN_CYCLES = DEPTH + 1;
  localparam int unsigned DRAIN_BITS = $clog2(DRAIN_CYCLES + 1);

  logic soft_reset, awake_q;
  logic [DRAIN_BITS-1:0] drain_q;

  always_ff @(posedge clk_i) begin
    if (!rst_ni || soft_reset) begin
      drain_q <= DRAIN_BITS'(DRAIN_CYCLES);
      awake_q <= 1'b0;
    end else begin
      if (drain_q != '0) drain_q <= drain_q - 1'b1;
      awake_q <= drain_q == '0;
    end
  end

  // ---- The address space ----

  logic busy, start, done, last_step, ring, keys_stale, keys_next, keys_valid;
  logic [NumRegions-1:0] host_re, host_we;
  logic [WORD_ADDR_BITS-1:0] host_index;
  logic [DATA_WL-1:0] host_wdata, next_host_wdata;
  logic [NumRegions-1:0][DATA_WL-1:0] host_rdata;
  logic [DATA_WL-1:0] state_rdata;
  assign host_rdata[Elapsed:InitialStates] = '0;
  logic busy_write, busy_doorbell, untorn;
  // Registers are read whether asked or not, read-only regions never written, and no region is as
  // long as the map.
  logic unused_host;
  assign unused_host = ^{host_re[Control], host_re[Doorbell], host_re[Status], host_index,
                         host_we[Observations], host_we[Rewards], host_we[Ters], host_we[Status],
                         host_re[Policy], host_re[Statistics], host_we[Policy], host_we[Statistics]};

  pearl_port #(
      .DATA_WL(DATA_WL),
      .WORD_ADDR_BITS(WORD_ADDR_BITS),
      .OFFSETS(OFFSETS)
  ) u_port (
      .clk_i,
      .rst_ni,
      .req_i,
      .we_i,
      .fetch_i,
      .addr_i,
      .wdata_i,
      .rvalid_o,
      .rdata_o,
      .resp_o,
      .busy_i         (busy || !awake_q),
      .re_o           (host_re),
      .we_o           (host_we),
      .index_o        (host_index),
      .wdata_o        (host_wdata),
      .next_wdata_o   (next_host_wdata),
      .rdata_i        (host_rdata),
      .late_rdata_i   (state_rdata),
      .busy_write_o   (busy_write),
      .busy_doorbell_o(busy_doorbell),
      .untorn_o       (untorn),
      .soft_reset_o   (soft_reset)
  );

  mode_t mode;
  logic [1:0][31:0] seed;
  logic [63:0] tick;
  logic [31:0] first_slot, limit, steps, cycles, step_cycles;
  logic limited;

  pearl_registers #(
      .DATA_WL    (DATA_WL),
      .N_ENVS     (N_ENVS),
      .PE_NUM     (PE_NUM),
      .STATE_BITS (STATE_BITS),
      .RESULT_BITS(OBS_BITS + REWARD_BITS + TER_BITS),
      .ENV_HASH   (ENV_HASH),
      .ENGINE     (ENGINE)
  ) u_registers (
      .clk_i,
      .rst_ni,
      .draining_i     (!awake_q),
      .index_i        (host_index[index_bits(stream_words(CONTROL_WORDS, 32, DATA_WL))-1:0]),
      .control_we_i   (host_we[Control]),
      .doorbell_we_i  (host_we[Doorbell]),
      .wdata_i        (host_wdata),
      .next_wdata_i   (next_host_wdata),
      .control_o      (host_rdata[Control]),
      .doorbell_o     (host_rdata[Doorbell]),
      .status_o       (host_rdata[Status]),
      .ring_o         (ring),
      .mode_o         (mode),
      .seed_o         (seed),
      .tick_o         (tick),
      .keys_stale_o   (keys_stale),
      .keys_next_o    (keys_next),
      .first_slot_o   (first_slot),
      .limited_o      (limited),
      .limit_o        (limit),
      .steps_o        (steps),
      .done_i         (done),
      .last_i         (last_step),
      .cycles_i       (cycles),
      .busy_write_i   (busy_write),
      .busy_doorbell_i(busy_doorbell),
      .untorn_i       (untorn)
  );

  logic obs_done, rewards_done, ters_done, irq_q;
  // Whether the doorbell was for a rollout; of its steps: one is to begin, none runs although there are more, the
  // random keys of its actions are there, and what became of it is in the sums.
  logic rollout, stepping, ring_step, between_steps, policy_keys_valid, counted;

  pearl_sequencer u_sequencer (
      .clk_i,
      .rst_ni        (awake_q),
      .ring_i        (ring_step),
      .keys_valid_i  (keys_valid && policy_keys_valid),
      .results_done_i(rollout ? counted : obs_done && rewards_done && ters_done),
      .busy_o        (stepping),
      .start_o       (start),
      .done_o        (done),
      .cycles_o      (step_cycles)
  );
  assign busy = stepping || between_steps;

  always_ff @(posedge clk_i) begin
    if (!awake_q || ring) irq_q <= 1'b0;
    else if (done && last_step) irq_q <= 1'b1;
  end
  assign irq_o = irq_q;

  // ---- From the host's words to groups: actions, reset bits, random draws ----

  typedef struct packed {
    logic valid;
    logic last;
    logic observe;
    logic [GROUP_BITS-1:0] group;
    logic [31:0] slot;
  } issue_t;

  // The next group, of a step or of a rollout.
  issue_t issue, plain, rolled;
  // With what actions, where it is of a rollout; and with what resets.
  logic [PE_NUM-1:0][ACTION_BITS-1:0] chosen;
  mode_t path_mode;
  logic actions_valid, resets_valid;
  logic [PE_NUM-1:0][ACTION_BITS-1:0] actions;
  logic [PE_NUM-1:0] resets;

  pearl_input_bank #(
      .ROW_BITS(PE_NUM * ACTION_BITS),
      .DATA_WL (DATA_WL),
      .WORDS   (ACTION_WORDS)
  ) u_actions (
      .clk_i,
      .rst_ni      (awake_q),
      .busy_i      (busy),
      .start_i     (start),
      .valid_o     (actions_valid),
      .row_o       (actions),
      .take_i      (plain.valid),
      .host_re_i   (host_re[Actions]),
      .host_we_i   (host_we[Actions]),
      .host_addr_i (host_index[index_bits(ACTION_WORDS)-1:0]),
      .host_wdata_i(host_wdata),
      .host_rdata_o(host_rdata[Actions])
  );

  pearl_input_bank #(
      .ROW_BITS(PE_NUM),
      .DATA_WL (DATA_WL),
      .WORDS   (MASK_WORDS)
  ) u_reset_mask (
      .clk_i,
      .rst_ni      (awake_q),
      .busy_i      (busy),
      .start_i     (start),
      .valid_o     (resets_valid),
      .row_o       (resets),
      .take_i      (plain.valid),
      .host_re_i   (host_re[ResetMask]),
      .host_we_i   (host_we[ResetMask]),
      .host_addr_i (host_index[index_bits(MASK_WORDS)-1:0]),
      .host_wdata_i(host_wdata),
      .host_rdata_o(host_rdata[ResetMask])
  );

  pearl_group_reader #(
      .GROUPS     (GROUPS),
      .PE_NUM     (PE_NUM),
      .DATA_WL    (DATA_WL),
      .II         (INTERVAL),
      .OBS_BITS   (OBS_BITS),
      .REWARD_BITS(REWARD_BITS),
      .TER_BITS   (TER_BITS)
  ) u_group_reader (
      .clk_i,
      .rst_ni      (awake_q),
      .start_i     (start && !rollout),
      .first_slot_i(first_slot),
      .rows_valid_i(actions_valid && resets_valid),
      .issue_o     (plain.valid),
      .group_o     (plain.group),
      .last_o      (plain.last),
      .slot_o      (plain.slot)
  );
  assign plain.observe = 1'b0;
  assign issue = rollout ? rolled : plain;

  logic [PE_NUM-1:0][RNG_WORDS-1:0][31:0] rng;

  pearl_draws #(
      .PE_NUM(PE_NUM),
      .DRAWS (DRAWS)
  ) u_draws (
      .clk_i,
      .rst_ni   (awake_q),
      .restart_i(keys_stale),
      .next_i   (keys_next),
      .seed_i   (seed),
      .tick_i   (tick),
      .valid_o  (keys_valid),
      .slot_i   (issue.slot),
      .draws_o  (rng)
  );

  // ---- Groups on their way ----

  logic at_result, results_valid, results_last, results_observe;
  logic [GROUP_BITS-1:0] results_group;
  logic [PE_NUM-1:0][AGENTS-1:0] gone;
  logic [PE_NUM-1:0][ELAPSED_BITS-1:0] elapsed;
  logic [PE_NUM-1:0][OBS_BITS-1:0] obs;
  logic [PE_NUM-1:0][REWARD_BITS-1:0] rewards;
  logic [PE_NUM-1:0][TER_BITS-1:0] ters;

  pearl_state_path #(
      .N_ENVS(N_ENVS),
      .PE_NUM(PE_NUM),
      .DATA_WL(DATA_WL),
      .HOST_ADDR_BITS(WORD_ADDR_BITS)
  ) u_state_path (
      .clk_i,
      .rst_ni      (awake_q),
      .busy_i      (busy),
      .mode_i      (path_mode),
      .limited_i   (limited),
      .limit_i     (limit),
      .issue_i     (issue.valid),
      .last_i      (issue.last),
      .observe_i   (issue.observe),
      .group_i     (issue.group),
      .actions_i   (rollout ? chosen : actions),
      .resets_i    (resets),
      .rng_i       (rng),
      .valid_o     (at_result),
      .last_o      (results_last),
      .observe_o   (results_observe),
      .group_o     (results_group),
      .obs_o       (obs),
      .rewards_o   (rewards),
      .ters_o      (ters),
      .gone_o      (gone),
      .elapsed_o   (elapsed),
      .host_re_i   (host_re[Elapsed:InitialStates]),
      .host_we_i   (host_we[Elapsed:InitialStates]),
      .host_addr_i (host_index),
      .host_wdata_i(host_wdata),
      .host_rdata_o(state_rdata)
  );

  // A rollout leaves no results but its sums.
  assign results_valid = at_result && !rollout;

  // ---- Rollouts: the policy engine, and what becomes of episodes ----

  if (ENGINE == NoEngine) begin : gen_no_engine
    logic unused;
    assign unused = ^{steps, results_observe, results_group, gone, elapsed};
    assign rollout = 1'b0;
    assign ring_step = ring;
    assign between_steps = 1'b0;
    assign last_step = 1'b1;
    assign policy_keys_valid = 1'b1;
    assign counted = 1'b1;
    assign cycles = step_cycles;
    assign rolled = '0;
    assign chosen = '0;
    assign path_mode = mode;
    assign host_rdata[Policy] = '0;
    assign host_rdata[Statistics] = '0;
  end else begin : gen_engine
    pearl_rollout #(
        .GROUPS(GROUPS),
        .PE_NUM(PE_NUM),
        .DATA_WL(DATA_WL),
        .INTERVAL(INTERVAL),
        .DEPTH(DEPTH)
    ) u_rollout (
        .clk_i,
        .rst_ni         (awake_q),
        .policy_we_i    (host_we[Policy]),
        .host_index_i   (host_index[POLICY_INDEX_BITS-1:0]),
        .host_wdata_i   (host_wdata[31:0]),
        .statistics_o   (host_rdata[Statistics]),
        .ring_i         (ring),
        .mode_i         (mode),
        .steps_i        (steps),
        .first_slot_i   (first_slot),
        .start_i        (start),
        .done_i         (done),
        .last_step_o    (last_step),
        .rollout_o      (rollout),
        .mode_o         (path_mode),
        .ring_o         (ring_step),
        .between_o      (between_steps),
        .cycles_o       (cycles),
        .keys_stale_i   (keys_stale),
        .keys_next_i    (keys_next),
        .seed_i         (seed),
        .tick_i         (tick),
        .keys_valid_o   (policy_keys_valid),
        .issue_o        (rolled.valid),
        .issue_last_o   (rolled.last),
        .issue_observe_o(rolled.observe),
        .issue_group_o  (rolled.group),
        .issue_slot_o   (rolled.slot),
        .actions_o      (chosen),
        .valid_i        (at_result && rollout),
        .last_i         (results_last),
        .observe_i      (results_observe),
        .group_i        (results_group),
        .obs_i          (obs),
        .rewards_i      (rewards),
        .ters_i         (ters),
        .gone_i         (gone),
        .elapsed_i      (elapsed),
        .counted_o      (counted)
    );
    // What is written there is not read, and the cycles of each step are part of those of all.
    assign host_rdata[Policy] = '0;
    logic unused;
    assign unused = ^step_cycles;
  end

  // ---- From groups to the host's words: three banks, written in parallel ----

  pearl_result_bank #(
      .ROW_BITS(PE_NUM * OBS_BITS),
      .DATA_WL (DATA_WL),
      .WORDS   (OBS_WORDS)
  ) u_observations (
      .clk_i,
      .rst_ni      (awake_q),
      .start_i     (start),
      .valid_i     (results_valid),
      .last_i      (results_last),
      .row_i       (obs),
      .done_o      (obs_done),
      .host_re_i   (host_re[Observations]),
      .host_addr_i (host_index[index_bits(OBS_WORDS)-1:0]),
      .host_rdata_o(host_rdata[Observations])
  );

  pearl_result_bank #(
      .ROW_BITS(PE_NUM * REWARD_BITS),
      .DATA_WL (DATA_WL),
      .WORDS   (REWARD_WORDS)
  ) u_rewards (
      .clk_i,
      .rst_ni      (awake_q),
      .start_i     (start),
      .valid_i     (results_valid),
      .last_i      (results_last),
      .row_i       (rewards),
      .done_o      (rewards_done),
      .host_re_i   (host_re[Rewards]),
      .host_addr_i (host_index[index_bits(REWARD_WORDS)-1:0]),
      .host_rdata_o(host_rdata[Rewards])
  );

  pearl_result_bank #(
      .ROW_BITS(PE_NUM * TER_BITS),
      .DATA_WL (DATA_WL),
      .WORDS   (TER_WORDS)
  ) u_ters (
      .clk_i,
      .rst_ni      (awake_q),
      .start_i     (start),
      .valid_i     (results_valid),
      .last_i      (results_last),
      .row_i       (ters),
      .done_o      (ters_done),
      .host_re_i   (host_re[Ters]),
      .host_addr_i (host_index[index_bits(TER_WORDS)-1:0]),
      .host_rdata_o(host_rdata[Ters])
  );

endmodule
