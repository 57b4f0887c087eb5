// One slot, any one, in one step of the whole backbone, from any state between two steps.
//
// Between two steps nothing is in the pipeline and nothing will be before the next start: `idle`. The
// first FLUSH cycles here have no group in them, whatever state they began in, so that the state after them is any
// idle one and more. Three proofs are a whole one:
//
// - PROVE_RESET: whatever went before, a reset leads to an idle state;
// - PROVE_IDLE: an idle state stays one until a step starts;
// - PROVE_STEP: a step that starts in an idle state serves the slot, ends in time, and leaves an idle
//   state.
module slot_proof
  import pearl_pkg::*;
#(
    parameter int unsigned N_ENVS = 5,
    parameter int unsigned PE_NUM = 2,
    parameter int unsigned DATA_WL = 32,
    parameter bit PIPELINED = 1'b1,
    parameter int unsigned DRAWS = 0,
    // A step takes no more cycles, from its start.
    parameter int unsigned STEP_CYCLES = 20,
    parameter int unsigned WORD_ADDR_BITS = 14
) (
    input logic                      clk_i,
    input logic                      rst_ni,
    input logic                      req_i,
    input logic                      we_i,
    input logic [WORD_ADDR_BITS-1:0] addr_i,
    input logic [       DATA_WL-1:0] wdata_i
);

  localparam int unsigned LATENCY = pearl_core_pkg::LATENCY;
  localparam int unsigned STATE_BITS = pearl_core_pkg::STATE_BITS;
  localparam int unsigned ACTION_BITS = pearl_core_pkg::ACTION_BITS;
  localparam int unsigned OBS_BITS = pearl_core_pkg::OBS_BITS;
  localparam int unsigned REWARD_BITS = pearl_core_pkg::REWARD_BITS;
  localparam int unsigned SLOT_BITS = TER_BITS + STATE_BITS;
  localparam int unsigned RNG_WORDS = pearl_core_pkg::RNG_WORDS;
  localparam int unsigned GROUPS = ceil_div(N_ENVS, PE_NUM);
  // No group is in the pipeline for longer.
  localparam int unsigned FLUSH = DRAW_LATENCY + LATENCY + 1;

  logic irq, unused_rvalid;
  logic [DATA_WL-1:0] unused_rdata;
  resp_e unused_resp;

  pearl_backbone #(
      .N_ENVS(N_ENVS),
      .PE_NUM(PE_NUM),
      .DATA_WL(DATA_WL),
      .PIPELINED(PIPELINED),
      .DRAWS(DRAWS),
      `OFFSETS
      .WORD_ADDR_BITS(WORD_ADDR_BITS)
  ) u_backbone (
      .clk_i,
      .rst_ni,
      .req_i,
      .we_i,
      .addr_i,
      .wdata_i,
      .rvalid_o(unused_rvalid),
      .rdata_o (unused_rdata),
      .resp_o  (unused_resp),
      .irq_o   (irq)
  );

  // ---- Between steps ----

  logic start, done, issue, running, idle;
  assign start = u_backbone.start;
  assign done = u_backbone.done;
  assign issue = u_backbone.issue;
  assign running = u_backbone.u_sequencer.state_q == 2'd2;

  // How long this run is, and how long ago a group was issued.
  logic [7:0] age_q = '0, quiet_q = '0;
  always_ff @(posedge clk_i) begin
    if (age_q != '1) age_q <= age_q + 1'b1;
    if (issue) quiet_q <= '0;
    else if (quiet_q != '1) quiet_q <= quiet_q + 1'b1;
  end
  assign idle = !running && !u_backbone.u_group_reader.active_q && quiet_q >= 8'(FLUSH);

`ifdef PROVE_RESET
  // The backbone's contract.
  always_comb assume (rst_ni == (age_q >= 8'(LATENCY + 4)));
  always_comb if (age_q == 8'(LATENCY + 4)) assert (idle);
`else

  always_comb begin
    if (age_q < 8'(FLUSH)) assume (!issue);
    if (age_q == 8'(FLUSH)) assume (idle);
  end

`ifdef PROVE_IDLE
  always_comb begin
    if (age_q == 8'(FLUSH)) assume (!start);
    if (age_q == 8'(FLUSH + 1)) assert (idle);
  end
`endif

`ifdef PROVE_STEP
  // ---- The slot, and one bit of each of its words ----

  logic [7:0] any_slot, any_group, any_pe, slot, group, pe;
  logic [3:0][7:0] any_bit, bits;
  logic [6:0][7:0] kept_q;
  logic fixed_q = 1'b0;
  assign slot  = fixed_q ? kept_q[0] : any_slot;
  assign group = fixed_q ? kept_q[1] : any_group;
  assign pe    = fixed_q ? kept_q[2] : any_pe;
  for (genvar i = 0; i < 4; i++) begin : gen_bits
    assign bits[i] = fixed_q ? kept_q[3+i] : any_bit[i];
    always_ff @(posedge clk_i) kept_q[3+i] <= bits[i];
  end
  always_ff @(posedge clk_i) begin
    fixed_q   <= 1'b1;
    kept_q[0] <= slot;
    kept_q[1] <= group;
    kept_q[2] <= pe;
  end
  always_comb begin
    assume (slot < 8'(N_ENVS) && group < 8'(GROUPS) && pe < 8'(PE_NUM));
    assume (slot == group * 8'(PE_NUM) + pe);
    assume (bits[0] < 8'(ACTION_BITS) && bits[1] < 8'(OBS_BITS) && bits[2] < 8'(REWARD_BITS) && bits[3] < 8'(TER_BITS));
  end

  // Where the map says that it is.
  localparam int unsigned STATE_COLUMNS = ceil_div(PE_NUM * SLOT_BITS, DATA_WL);
  localparam int unsigned INIT_COLUMNS = ceil_div(PE_NUM * STATE_BITS, DATA_WL);
  localparam int unsigned ELAPSED_COLUMNS = ceil_div(PE_NUM * ELAPSED_BITS, DATA_WL);
  logic [STATE_COLUMNS*DATA_WL-1:0] state_row;
  logic [INIT_COLUMNS*DATA_WL-1:0] init_row;
  logic [ELAPSED_COLUMNS*DATA_WL-1:0] elapsed_row;
  for (genvar i = 0; i < STATE_COLUMNS; i++) begin : gen_state
    always_comb assume (8'(u_backbone.u_current_states.gen_column_rams[i].u_ram.tracked) == group);
    assign state_row[i*DATA_WL+:DATA_WL] =
        DATA_WL'(u_backbone.u_current_states.gen_column_rams[i].u_ram.content_q);
  end
  for (genvar i = 0; i < INIT_COLUMNS; i++) begin : gen_init
    always_comb assume (8'(u_backbone.u_initial_states.gen_column_rams[i].u_ram.tracked) == group);
    assign init_row[i*DATA_WL+:DATA_WL] =
        DATA_WL'(u_backbone.u_initial_states.gen_column_rams[i].u_ram.content_q);
  end
  for (genvar i = 0; i < ELAPSED_COLUMNS; i++) begin : gen_elapsed
    always_comb assume (8'(u_backbone.u_elapsed.gen_column_rams[i].u_ram.tracked) == group);
    assign elapsed_row[i*DATA_WL+:DATA_WL] =
        DATA_WL'(u_backbone.u_elapsed.gen_column_rams[i].u_ram.content_q);
  end
  logic [4:0][9:0] at;
  assign at[0] = 10'(slot) * 10'(ACTION_BITS) + 10'(bits[0]);
  assign at[1] = 10'(slot) * 10'(OBS_BITS) + 10'(bits[1]);
  assign at[2] = 10'(slot) * 10'(REWARD_BITS) + 10'(bits[2]);
  assign at[3] = 10'(slot) * 10'(TER_BITS) + 10'(bits[3]);
  assign at[4] = 10'(slot);
  logic action_bit, obs_bit, reward_bit, ter_bit, mask_bit;
  always_comb begin
    assume (10'(u_backbone.u_actions.u_ram.tracked) == at[0] / 10'(DATA_WL));
    assume (10'(u_backbone.u_observations.u_ram.tracked) == at[1] / 10'(DATA_WL));
    assume (10'(u_backbone.u_rewards.u_ram.tracked) == at[2] / 10'(DATA_WL));
    assume (10'(u_backbone.u_ters.u_ram.tracked) == at[3] / 10'(DATA_WL));
    assume (10'(u_backbone.u_reset_mask.u_ram.tracked) == at[4] / 10'(DATA_WL));
  end
  assign action_bit = u_backbone.u_actions.u_ram.content_q[at[0][$clog2(DATA_WL)-1:0]];
  assign obs_bit = u_backbone.u_observations.u_ram.content_q[at[1][$clog2(DATA_WL)-1:0]];
  assign reward_bit = u_backbone.u_rewards.u_ram.content_q[at[2][$clog2(DATA_WL)-1:0]];
  assign ter_bit = u_backbone.u_ters.u_ram.content_q[at[3][$clog2(DATA_WL)-1:0]];
  assign mask_bit = u_backbone.u_reset_mask.u_ram.content_q[at[4][$clog2(DATA_WL)-1:0]];

  logic [TER_BITS-1:0] ter_word;
  logic [STATE_BITS-1:0] state_word, init_word;
  logic [ELAPSED_BITS-1:0] elapsed_word;
  assign {ter_word, state_word} = state_row[pe*SLOT_BITS+:SLOT_BITS];
  assign init_word = init_row[pe*STATE_BITS+:STATE_BITS];
  assign elapsed_word = elapsed_row[pe*ELAPSED_BITS+:ELAPSED_BITS];

  // ---- What the slot has when the step starts ----

  logic step_q = 1'b0, over_q = 1'b0, action_q, reset_q;
  logic [TER_BITS-1:0] ter_q;
  logic [STATE_BITS-1:0] state_q, init_q;
  logic [ELAPSED_BITS-1:0] elapsed_q;
  mode_t mode_q;
  logic [31:0] draw_slot_q, limit_q;

  always_comb if (age_q == 8'(FLUSH)) assume (start);
  always_comb assume (rst_ni || age_q < 8'(FLUSH));

  always_ff @(posedge clk_i) begin
    if (age_q == 8'(FLUSH)) begin
      step_q <= 1'b1;
      action_q <= action_bit;
      reset_q <= mask_bit;
      ter_q <= ter_word;
      state_q <= state_word;
      init_q <= init_word;
      elapsed_q <= elapsed_word;
      mode_q <= u_backbone.mode;
      draw_slot_q <= u_backbone.first_slot + 32'(slot);
      limit_q <= u_backbone.max_cycles;
    end else if (done && step_q) begin
      step_q <= 1'b0;
      over_q <= 1'b1;
    end
  end

  // ---- What its core is asked, what it answers ----

  logic named, ended, first, hold, truncated;
  logic [ELAPSED_BITS:0] next_elapsed;
  assign named = mode_q.reset_all || (mode_q.reset_mask && reset_q);
  assign ended = ter_q != '0;
  assign first = named || ended;
  assign hold = ended && !named && mode_q.next_step;
  assign next_elapsed = hold ? '0 : first ? 33'd1 : 33'(elapsed_q) + 33'd1;
  assign truncated = !hold && limit_q != '0 && next_elapsed >= 33'(limit_q);

  logic [PE_NUM-1:0] core_valid_in, core_valid_out, core_first, core_hold, core_terminated;
  logic [PE_NUM-1:0][STATE_BITS-1:0] core_state_in, core_state_out;
  logic [PE_NUM-1:0][ACTION_BITS-1:0] core_action;
  logic [PE_NUM-1:0][RNG_WORDS-1:0][31:0] core_rng;
  logic [PE_NUM-1:0][OBS_BITS-1:0] core_obs;
  logic [PE_NUM-1:0][REWARD_BITS-1:0] core_reward;
  for (genvar i = 0; i < PE_NUM; i++) begin : gen_core
    assign core_valid_in[i] = u_backbone.u_pe_array.gen_pe[i].u_pe.u_core.valid_i;
    assign core_valid_out[i] = u_backbone.u_pe_array.gen_pe[i].u_pe.u_core.valid_o;
    assign core_first[i] = u_backbone.u_pe_array.gen_pe[i].u_pe.u_core.first_i;
    assign core_hold[i] = u_backbone.u_pe_array.gen_pe[i].u_pe.u_core.hold_i;
    assign core_state_in[i] = u_backbone.u_pe_array.gen_pe[i].u_pe.u_core.state_i;
    assign core_action[i] = u_backbone.u_pe_array.gen_pe[i].u_pe.u_core.action_i;
    assign core_rng[i] = u_backbone.u_pe_array.gen_pe[i].u_pe.u_core.rng_i;
    assign core_state_out[i] = u_backbone.u_pe_array.gen_pe[i].u_pe.u_core.state_o;
    assign core_obs[i] = u_backbone.u_pe_array.gen_pe[i].u_pe.u_core.obs_o;
    assign core_reward[i] = u_backbone.u_pe_array.gen_pe[i].u_pe.u_core.reward_o;
    assign core_terminated[i] = u_backbone.u_pe_array.gen_pe[i].u_pe.u_core.terminated_o;
  end

  // The core of the slot's element gets the slots of one group after the other.
  logic [7:0] asked_q, answered_q, reads_q, writes_q;
  logic asked, answered, obs_q, reward_q, terminated_q;
  logic [STATE_BITS-1:0] next_q;
  assign asked = core_valid_in[pe] && asked_q == group;
  assign answered = core_valid_out[pe] && answered_q == group;

  always_ff @(posedge clk_i) begin
    if (!step_q) begin
      asked_q <= '0;
      answered_q <= '0;
      reads_q <= '0;
      writes_q <= '0;
    end else begin
      asked_q <= asked_q + 8'(core_valid_in[pe]);
      answered_q <= answered_q + 8'(core_valid_out[pe]);
      reads_q <= reads_q + 8'(u_backbone.u_current_states.re_i && 8'(u_backbone.u_current_states.raddr_i) == group);
      writes_q <= writes_q + 8'(u_backbone.u_current_states.we_i && 8'(u_backbone.u_current_states.waddr_i) == group);
    end
    if (answered) begin
      next_q <= core_state_out[pe];
      obs_q <= core_obs[pe][bits[1]];
      reward_q <= core_reward[pe][bits[2]];
      terminated_q <= core_terminated[pe];
    end
  end

  logic [RNG_WORDS-1:0][31:0] draw_keys;
  if (DRAWS == 0) begin : gen_no_keys
    assign draw_keys = '0;
  end else begin : gen_keys
    for (genvar i = 0; i < DRAWS; i++) begin : gen_key
      assign draw_keys[i] = u_backbone.gen_draws.key_a[i] ^
          {u_backbone.gen_draws.key_b[i][0], u_backbone.gen_draws.key_b[i][31:1]};
    end
  end
  logic [7:0] over_age_q;
  always_ff @(posedge clk_i) if (done && step_q) over_age_q <= age_q + 1'b1;

  always_comb begin
    if (step_q) begin
      if (asked) begin
        assert (core_first[pe] == (first && !mode_q.stored));
        assert (core_hold[pe] == hold);
        assert (core_state_in[pe] == (first && mode_q.stored ? init_q : state_q));
        assert (core_action[pe][bits[0]] == action_q);
        for (int unsigned i = 0; i < DRAWS; i++) begin
          assert (core_rng[pe][i] == (draw_slot_q ^ draw_keys[i]));
        end
      end
      if (done) begin
        assert (32'(asked_q) == GROUPS && 32'(answered_q) == GROUPS);
        assert (reads_q == 8'd1 && writes_q == 8'd1);
        assert (state_word == next_q);
        assert (ter_word == {truncated, terminated_q && !hold});
        assert (elapsed_word == next_elapsed[ELAPSED_BITS-1:0]);
        assert (obs_bit == obs_q);
        assert (reward_bit == (reward_q && !hold));
        assert (ter_bit == ter_word[bits[3]]);
      end
      assert (32'(age_q) <= FLUSH + STEP_CYCLES);
    end
    if (over_q && age_q == over_age_q) assert (idle);
  end
`endif
`endif

endmodule
