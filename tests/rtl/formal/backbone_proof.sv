// SPDX-License-Identifier: MIT
// Of the whole backbone, whatever its core answers and the host does, for ever.
//
// Between two steps it is `idle`: nothing is on the state path, and nothing will be before the next start.
// The runs here start in any state at all. In their first BEGIN cycles no group is issued, so that what
// comes then is any idle state (and more). Proofs of a few cycles make up one of all:
//
// - PROVE_RESET: after a reset, whatever was before it, the port is busy until the backbone is idle;
// - PROVE_IDLE: an idle state stays one until a step starts, and the status is right in it;
// - PROVE_STEP: in a step that starts in an idle state, one slot, any one, is read once and written
//   once; its core gets what is the slot's, and what the core answers ends where the slot's is; the
//   status comes within STEP_CYCLES, and not before all of that; then the state is idle again.
//
// In all of them the host's accesses are to the words that it meant, no address leaves its memory, and a
// packer has room for every row.
module backbone_proof
  import pearl_pkg::*;
  import pearl_core_pkg::*;
  import pearl_map_pkg::*;
#(
    parameter int unsigned N_ENVS = 5,
    parameter int unsigned PE_NUM = 2,
    parameter int unsigned DATA_WL = 32,
    parameter bit PIPELINED = 1'b1,
    // A step takes no more cycles from its start.
    parameter int unsigned STEP_CYCLES = 20,
    // The slot; N_ENVS stands for any.
    parameter int unsigned SLOT = N_ENVS,
    localparam int unsigned WORD_ADDR_BITS = $clog2(region_offset(NumRegions, N_ENVS, PE_NUM, DATA_WL) + 1)
) (
    input logic                      clk_i,
    input logic                      rst_ni,
    input logic                      req_i,
    input logic                      we_i,
    input logic                      fetch_i,
    input logic [WORD_ADDR_BITS-1:0] addr_i,
    input logic [       DATA_WL-1:0] wdata_i
);

  localparam int unsigned GROUPS = ceil_div(N_ENVS, PE_NUM);
  // No group is on its way for longer.
  localparam int unsigned FLUSH = issue_to_core(DRAWS) + LATENCY + 2;
  // And then no input bank has anything to read: its queue, which may begin out of step with it, has filled up.
  localparam int unsigned BEGIN = FLUSH + 3;
  localparam int unsigned TIME_BITS = 8;

  logic irq, unused_rvalid;
  logic [DATA_WL-1:0] unused_rdata;
  resp_e unused_resp;

  pearl_backbone #(
      .N_ENVS(N_ENVS),
      .PE_NUM(PE_NUM),
      .DATA_WL(DATA_WL),
      .PIPELINED(PIPELINED),
      .WORD_ADDR_BITS(WORD_ADDR_BITS)
  ) u_backbone (
      .clk_i,
      .rst_ni,
      .req_i,
      .we_i,
      .fetch_i,
      .addr_i,
      .wdata_i,
      .rvalid_o(unused_rvalid),
      .rdata_o (unused_rdata),
      .resp_o  (unused_resp),
      .irq_o   (irq)
  );

  // ---- Between two steps ----

  localparam int unsigned IDLE = 0;
  localparam int unsigned WAIT_KEYS = 3;

  logic start, done, awake, waiting, reset, settled, idle;
  logic [31:0] finished, sequence_number;
  assign start = u_backbone.start;
  assign done = u_backbone.done;
  assign awake = u_backbone.awake_q;
  assign reset = !rst_ni || u_backbone.soft_reset;
  assign waiting = 32'(u_backbone.u_sequencer.state_q) == WAIT_KEYS || start;
  assign finished = u_backbone.u_registers.finished_q;
  assign sequence_number = u_backbone.u_registers.sequence_q;

  // How many cycles there were before this one, and since the last group.
  logic [TIME_BITS-1:0] now_q = '0, quiet_q = '0;
  always_ff @(posedge clk_i) begin
    if (now_q != '1) now_q <= now_q + 1'b1;
    if (u_backbone.issue.valid) quiet_q <= '0;
    else if (quiet_q != '1) quiet_q <= quiet_q + 1'b1;
  end

  // A doorbell that has rung is answered neither by the status nor by the interrupt, and warns of results
  // that are not its own.
  assign settled = waiting ? finished != sequence_number && !irq && u_backbone.u_registers.error_q.torn_read
                           : finished == sequence_number;
  assign idle = awake && u_backbone.drain_q == '0 &&
      (32'(u_backbone.u_sequencer.state_q) == IDLE || waiting) &&
      !u_backbone.u_group_reader.active_q && quiet_q >= TIME_BITS'(FLUSH) && settled;

  // ---- The host's accesses ----

  // Cycles from a request to its access.
  localparam int unsigned TO_ACCESS = PORT_LATENCY - READ_LATENCY - 2;
  logic [WORD_ADDR_BITS-1:0] meant;
  pearl_delay #(
      .WIDTH (WORD_ADDR_BITS),
      .STAGES(TO_ACCESS)
  ) u_meant (
      .clk_i,
      .d_i(addr_i),
      .d_o(meant)
  );
  for (genvar i = 0; i < NumRegions; i++) begin : gen_region
    localparam int unsigned OFFSET = region_offset(i, N_ENVS, PE_NUM, DATA_WL);
    localparam int unsigned WORDS = region_words(i, N_ENVS, PE_NUM, DATA_WL);
    always_comb begin
      if (now_q >= TIME_BITS'(TO_ACCESS) && (u_backbone.host_re[i] || u_backbone.host_we[i])) begin
        assert (32'(u_backbone.host_index) + OFFSET == 32'(meant));
        assert (32'(u_backbone.host_index) < WORDS);
        assert ((u_backbone.host_re | u_backbone.host_we) == NumRegions'(1) << i);
      end
    end
  end
  // Nothing is written in a step, and nothing read that the state path uses.
  localparam logic [NumRegions-1:0] MEMORIES =
      NumRegions'(1 << InitialStates | 1 << CurrentStates | 1 << Elapsed | 1 << ResetMask | 1 << Actions);
  logic was_busy_q;
  always_ff @(posedge clk_i) was_busy_q <= u_backbone.busy;
  always_comb begin
    if (now_q >= TIME_BITS'(TO_ACCESS) && u_backbone.busy && was_busy_q) begin
      assert (u_backbone.host_we == '0 && (u_backbone.host_re & MEMORIES) == '0);
    end
  end

`ifdef PROVE_RESET
  always_comb begin
    assume (reset == (now_q == '0));
    if (now_q != '0 && !awake) begin
      assert (!start && !done && !irq && u_backbone.host_we == '0);
      assert (32'(now_q) <= FLUSH + 1);
    end
  end
  logic asleep_q;
  always_ff @(posedge clk_i) asleep_q <= !awake;
  always_comb if (now_q > TIME_BITS'(1) && awake && asleep_q) assert (idle && finished == '0);
  always_comb if (now_q == TIME_BITS'(FLUSH + 2)) assert (awake);
`endif

`ifndef PROVE_RESET
  always_comb begin
    if (now_q < TIME_BITS'(BEGIN)) assume (!u_backbone.issue.valid);
    if (now_q == TIME_BITS'(BEGIN)) assume (idle);
    if (now_q >= TIME_BITS'(BEGIN)) assume (!reset);
  end
`endif

`ifdef PROVE_IDLE
  logic warned_q;
  always_ff @(posedge clk_i) warned_q <= u_backbone.u_registers.error_q.torn_read;
  logic read_q;
  always_ff @(posedge clk_i) begin
    read_q <= u_backbone.host_re[Observations] && u_backbone.host_index == '0 && !u_backbone.busy;
  end
  always_comb begin
    if (now_q == TIME_BITS'(BEGIN)) assume (!start);
    if (now_q == TIME_BITS'(BEGIN + 1)) begin
      assert (idle);
      // Results are right from their first word on, or the status says that they are not.
      assert (u_backbone.u_registers.error_q.torn_read || !warned_q || read_q);
    end
  end
`endif

`ifdef PROVE_STEP
  // ---- A slot, and one bit of its action and of each of its results ----

  localparam int unsigned FIELDS = 4;
  localparam int unsigned AT_BITS = 10;
  typedef struct packed {
    logic [7:0] slot;
    logic [7:0] group;
    logic [7:0] pe;
    logic [FIELDS-1:0][7:0] bits;
  } chosen_t;

  logic fixed_q = 1'b0;
  chosen_t any_choice, choice_q, choice;
  assign choice = fixed_q ? choice_q : any_choice;
  always_ff @(posedge clk_i) begin
    fixed_q  <= 1'b1;
    choice_q <= choice;
  end

  localparam bit ANY = SLOT == N_ENVS;
  logic [7:0] slot, group, pe;
  assign slot = ANY ? choice.slot : 8'(SLOT);
  assign group = ANY ? choice.group : 8'(SLOT / PE_NUM);
  assign pe = ANY ? choice.pe : 8'(SLOT % PE_NUM);

  always_comb begin
    assume (slot < 8'(N_ENVS) && group < 8'(GROUPS) && pe < 8'(PE_NUM));
    assume (slot == group * 8'(PE_NUM) + pe);
    assume (choice.bits[0] < 8'(ACTION_BITS) && choice.bits[1] < 8'(OBS_BITS));
    assume (choice.bits[2] < 8'(REWARD_BITS) && choice.bits[3] < 8'(TER_BITS));
  end

  // ---- Where the map says that they are ----

  logic [FIELDS:0][AT_BITS-1:0] at;
  assign at[0] = AT_BITS'(slot) * AT_BITS'(ACTION_BITS) + AT_BITS'(choice.bits[0]);
  assign at[1] = AT_BITS'(slot) * AT_BITS'(OBS_BITS) + AT_BITS'(choice.bits[1]);
  assign at[2] = AT_BITS'(slot) * AT_BITS'(REWARD_BITS) + AT_BITS'(choice.bits[2]);
  assign at[3] = AT_BITS'(slot) * AT_BITS'(TER_BITS) + AT_BITS'(choice.bits[3]);
  assign at[4] = AT_BITS'(slot);

  localparam int unsigned IN_WORD = $clog2(DATA_WL);
  logic action_bit, obs_bit, reward_bit, ter_bit, mask_bit;
  always_comb begin
    assume (AT_BITS'(u_backbone.u_actions.u_ram.u_memory.addr) == at[0] >> IN_WORD);
    assume (AT_BITS'(u_backbone.u_observations.u_ram.u_memory.addr) == at[1] >> IN_WORD);
    assume (AT_BITS'(u_backbone.u_rewards.u_ram.u_memory.addr) == at[2] >> IN_WORD);
    assume (AT_BITS'(u_backbone.u_ters.u_ram.u_memory.addr) == at[3] >> IN_WORD);
    assume (AT_BITS'(u_backbone.u_reset_mask.u_ram.u_memory.addr) == at[4] >> IN_WORD);
  end
  assign action_bit = u_backbone.u_actions.u_ram.u_memory.content_q[at[0][IN_WORD-1:0]];
  assign obs_bit = u_backbone.u_observations.u_ram.u_memory.content_q[at[1][IN_WORD-1:0]];
  assign reward_bit = u_backbone.u_rewards.u_ram.u_memory.content_q[at[2][IN_WORD-1:0]];
  assign ter_bit = u_backbone.u_ters.u_ram.u_memory.content_q[at[3][IN_WORD-1:0]];
  assign mask_bit = u_backbone.u_reset_mask.u_ram.u_memory.content_q[at[4][IN_WORD-1:0]];

  // The row of the slot's group in a row memory: all words of the row, side by side.
  `define KNOWN_ROW(NAME, MEMORY, SLOT_WIDTH) \
  logic [ceil_div(PE_NUM * SLOT_WIDTH, DATA_WL)*DATA_WL-1:0] NAME; \
  for (genvar i = 0; i < $bits(NAME) / DATA_WL; i++) begin : gen_``NAME \
    always_comb assume (8'(u_backbone.u_state_path.MEMORY.gen_column_rams[i].u_ram.u_memory.addr) == group); \
    assign NAME[i*DATA_WL+:DATA_WL] = \
        DATA_WL'(u_backbone.u_state_path.MEMORY.gen_column_rams[i].u_ram.u_memory.content_q); \
  end
  `KNOWN_ROW(state_row, u_current_states, SLOT_BITS)
  `KNOWN_ROW(init_row, u_initial_states, STATE_BITS)
  `KNOWN_ROW(elapsed_row, u_elapsed, ELAPSED_BITS)
  `undef KNOWN_ROW

  logic [TER_BITS-1:0] ter;
  logic [STATE_BITS-1:0] state, init;
  logic [ELAPSED_BITS-1:0] elapsed;
  assign {ter, state} = state_row[pe*SLOT_BITS+:SLOT_BITS];
  assign init = init_row[pe*STATE_BITS+:STATE_BITS];
  assign elapsed = elapsed_row[pe*ELAPSED_BITS+:ELAPSED_BITS];

  // ---- What the slot has when the step starts ----

  logic step_q = 1'b0, over_q = 1'b0, action_q, named_q, ended_q;
  logic [STATE_BITS-1:0] state_q, init_q;
  logic [ELAPSED_BITS-1:0] elapsed_q;
  logic [AGENTS-1:0] gone_q;
  mode_t mode_q;
  logic [31:0] number_q, max_cycles_q, finished_q;

  always_comb if (now_q == TIME_BITS'(BEGIN)) assume (start);

  always_ff @(posedge clk_i) begin
    over_q <= step_q && done;
    if (now_q == TIME_BITS'(BEGIN)) begin
      step_q       <= 1'b1;
      action_q     <= action_bit;
      named_q      <= u_backbone.mode.reset_all || (u_backbone.mode.reset_mask && mask_bit);
      ended_q      <= ter[AGENTS] || &ter[AGENTS-1:0];
      gone_q       <= ter[AGENTS-1:0];
      state_q      <= state;
      init_q       <= init;
      elapsed_q    <= elapsed;
      mode_q       <= u_backbone.mode;
      number_q     <= u_backbone.first_slot + 32'(slot);
      max_cycles_q <= u_backbone.u_registers.max_cycles_q;
      finished_q   <= finished;
    end else if (done) begin
      step_q <= 1'b0;
    end
  end

  // ---- What its core is asked, and what it answers ----

  logic first, hold, truncated;
  logic [AGENTS-1:0] gone;
  logic [ELAPSED_BITS:0] next_elapsed;
  assign first = named_q || ended_q;
  assign hold = ended_q && !named_q && mode_q.next_step;
  // Who ended before in an episode that goes on.
  assign gone = first ? '0 : gone_q;
  assign next_elapsed = hold ? '0 : first ? 33'd1 : 33'(elapsed_q) + 33'd1;
  assign truncated = !hold && max_cycles_q != '0 && next_elapsed >= 33'(max_cycles_q);

  logic [RNG_WORDS-1:0][31:0] keys;
  if (DRAWS == 0) begin : gen_no_keys
    assign keys = '0;
  end else begin : gen_keys
    for (genvar i = 0; i < DRAWS; i++) begin : gen_key
      assign keys[i] = u_backbone.u_draws.gen_draws.key_a[i] ^
          {u_backbone.u_draws.gen_draws.key_b[i][0], u_backbone.u_draws.gen_draws.key_b[i][31:1]};
    end
  end

  logic [PE_NUM-1:0] asks, answers, firsts, holds;
  logic [PE_NUM-1:0][AGENTS-1:0] terminateds;
  logic [PE_NUM-1:0][STATE_BITS-1:0] states, next_states;
  logic [PE_NUM-1:0][ACTION_BITS-1:0] actions;
  logic [PE_NUM-1:0][RNG_WORDS-1:0][31:0] draws;
  logic [PE_NUM-1:0][OBS_BITS-1:0] observations;
  logic [PE_NUM-1:0][REWARD_BITS-1:0] rewards;
  for (genvar i = 0; i < PE_NUM; i++) begin : gen_core
    assign asks[i] = u_backbone.u_state_path.u_pe_array.gen_pe[i].u_pe.u_core.valid_i;
    assign firsts[i] = u_backbone.u_state_path.u_pe_array.gen_pe[i].u_pe.u_core.first_i;
    assign holds[i] = u_backbone.u_state_path.u_pe_array.gen_pe[i].u_pe.u_core.hold_i;
    assign states[i] = u_backbone.u_state_path.u_pe_array.gen_pe[i].u_pe.u_core.state_i;
    assign actions[i] = u_backbone.u_state_path.u_pe_array.gen_pe[i].u_pe.u_core.action_i;
    assign draws[i] = u_backbone.u_state_path.u_pe_array.gen_pe[i].u_pe.u_core.rng_i;
    assign answers[i] = u_backbone.u_state_path.u_pe_array.gen_pe[i].u_pe.u_core.valid_o;
    assign next_states[i] = u_backbone.u_state_path.u_pe_array.gen_pe[i].u_pe.u_core.state_o;
    assign observations[i] = u_backbone.u_state_path.u_pe_array.gen_pe[i].u_pe.u_core.obs_o;
    assign rewards[i] = u_backbone.u_state_path.u_pe_array.gen_pe[i].u_pe.u_core.reward_o;
    assign terminateds[i] = u_backbone.u_state_path.u_pe_array.gen_pe[i].u_pe.u_core.terminated_o;
  end

  // A core is asked of one group after the other.
  logic [7:0] asked_q, answered_q, reads_q, writes_q;
  logic asked, answered, obs_q, reward_q;
  logic [AGENTS-1:0] terminated_q;
  logic [STATE_BITS-1:0] next_state_q;
  assign asked = asks[pe] && asked_q == group;
  assign answered = answers[pe] && answered_q == group;

  always_ff @(posedge clk_i) begin
    if (!step_q) begin
      asked_q    <= '0;
      answered_q <= '0;
      reads_q    <= '0;
      writes_q   <= '0;
    end else begin
      asked_q <= asked_q + 8'(asks[pe]);
      answered_q <= answered_q + 8'(answers[pe]);
      if (u_backbone.u_state_path.u_current_states.re_i &&
          8'(u_backbone.u_state_path.u_current_states.raddr_i) == group)
        reads_q <= reads_q + 1'b1;
      if (u_backbone.u_state_path.u_current_states.we_i &&
          8'(u_backbone.u_state_path.u_current_states.waddr_i) == group)
        writes_q <= writes_q + 1'b1;
    end
    if (answered) begin
      next_state_q <= next_states[pe];
      obs_q        <= observations[pe][choice.bits[1]];
      reward_q     <= rewards[pe][choice.bits[2]];
      terminated_q <= terminateds[pe];
    end
  end

  always_comb begin
    if (step_q) begin
      if (asked) begin
        assert (firsts[pe] == (first && !mode_q.stored));
        assert (holds[pe] == hold);
        assert (states[pe] == (first && mode_q.stored ? init_q : state_q));
        assert (actions[pe][choice.bits[0]] == action_q);
        for (int unsigned i = 0; i < DRAWS; i++) assert (draws[pe][i] == (number_q ^ keys[i]));
      end
      if (done) begin
        assert (asked_q == 8'(GROUPS) && answered_q == 8'(GROUPS));
        assert (reads_q == 8'd1 && writes_q == 8'd1);
        assert (state == next_state_q);
        assert (ter == {truncated, hold ? AGENTS'(0) : gone | terminated_q});
        assert (elapsed == next_elapsed[ELAPSED_BITS-1:0]);
        assert (obs_bit == obs_q);
        assert (reward_bit == (reward_q && !hold));
        assert (ter_bit == ter[choice.bits[3]]);
      end
      assert (finished == finished_q && finished != sequence_number && !irq);
      assert (u_backbone.u_registers.error_q.torn_read);
      assert (32'(now_q) <= BEGIN + STEP_CYCLES);
    end
    if (over_q) assert (idle && irq && finished == sequence_number);
  end
`endif

endmodule
