// Everything but the bus: the memories and registers behind one memory port, and the pipeline that
// takes all slots through one step when the doorbell rings.
//
// pearl_top checks the sizes.
// Reset has to last LATENCY + 4 cycles (the core's LATENCY): what is in the pipeline is flushed, not
// reset, so that its delays can be shift-register LUTs.
module pearl_backbone
  import pearl_pkg::*;
  import pearl_core_pkg::*;
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
  // Cycles from a group's issue to its arrival at the processing elements: reading a memory takes
  // one, random draws take longer.
  localparam int unsigned FETCH = DRAWS == 0 ? 1 : DRAW_LATENCY;

  localparam int unsigned MASK_WORDS = stream_words(N_ENVS, 1, DATA_WL);
  localparam int unsigned ACTION_WORDS = stream_words(N_ENVS, ACTION_BITS, DATA_WL);
  localparam int unsigned OBS_WORDS = stream_words(N_ENVS, OBS_BITS, DATA_WL);
  localparam int unsigned REWARD_WORDS = stream_words(N_ENVS, REWARD_BITS, DATA_WL);
  localparam int unsigned TER_WORDS = stream_words(N_ENVS, TER_BITS, DATA_WL);
  // From one group's issue to the next one's. Not pipelined, a group is read, computed, and written a
  // word a cycle in each bank, before the next one is issued. Only the words of actions are fetched
  // ahead in either form.
  localparam int unsigned WIDER = OBS_BITS > REWARD_BITS ? OBS_BITS : REWARD_BITS;
  localparam int unsigned WIDEST = WIDER > TER_BITS ? WIDER : TER_BITS;
  localparam int unsigned SERIAL = FETCH + LATENCY + stream_words(PE_NUM, WIDEST, DATA_WL);
  localparam int unsigned INTERVAL = PIPELINED || SERIAL < II ? II : SERIAL;
  // A row memory's words per row are a power of two.
  localparam int unsigned INIT_COLUMNS_LOG2 = $clog2(stream_words(PE_NUM, STATE_BITS, DATA_WL));
  localparam int unsigned STATE_COLUMNS_LOG2 = $clog2(stream_words(PE_NUM, SLOT_BITS, DATA_WL));
  localparam int unsigned ELAPSED_COLUMNS_LOG2 = $clog2(stream_words(PE_NUM, ELAPSED_BITS, DATA_WL));

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
      offset_of(NumRegions)
  };

  // ---- The address space ----

  logic busy, start, done, ring, keys_stale, keys_valid;
  logic [NumRegions-1:0] host_re, host_we;
  logic [WORD_ADDR_BITS-1:0] host_index;
  logic [DATA_WL-1:0] host_wdata;
  logic [NumRegions-1:0][DATA_WL-1:0] host_rdata;
  logic busy_write, busy_doorbell, torn, untorn;
  // Registers are read whether asked or not, read-only regions never written, and no region is as
  // long as the map.
  logic unused_host;
  assign unused_host = ^{host_re[Control], host_re[Doorbell], host_re[Status], host_index,
                         host_we[Observations], host_we[Rewards], host_we[Ters], host_we[Status]};

  pearl_port #(
      .DATA_WL(DATA_WL),
      .WORD_ADDR_BITS(WORD_ADDR_BITS),
      .OFFSETS(OFFSETS)
  ) u_port (
      .clk_i,
      .rst_ni,
      .req_i,
      .we_i,
      .addr_i,
      .wdata_i,
      .rvalid_o,
      .rdata_o,
      .resp_o,
      .busy_i         (busy),
      .re_o           (host_re),
      .we_o           (host_we),
      .index_o        (host_index),
      .wdata_o        (host_wdata),
      .rdata_i        (host_rdata),
      .busy_write_o   (busy_write),
      .busy_doorbell_o(busy_doorbell),
      .torn_o         (torn),
      .untorn_o       (untorn)
  );

  mode_t mode;
  logic [1:0][31:0] seed;
  logic [63:0] tick;
  logic [31:0] first_slot, max_cycles, cycles;

  pearl_registers #(
      .DATA_WL    (DATA_WL),
      .N_ENVS     (N_ENVS),
      .PE_NUM     (PE_NUM),
      .STATE_BITS (STATE_BITS),
      .RESULT_BITS(OBS_BITS + REWARD_BITS + TER_BITS),
      .ENV_HASH   (ENV_HASH)
  ) u_registers (
      .clk_i,
      .rst_ni,
      .index_i        (host_index[index_bits(stream_words(CONTROL_WORDS, 32, DATA_WL))-1:0]),
      .control_we_i   (host_we[Control]),
      .doorbell_we_i  (host_we[Doorbell]),
      .wdata_i        (host_wdata),
      .control_o      (host_rdata[Control]),
      .doorbell_o     (host_rdata[Doorbell]),
      .status_o       (host_rdata[Status]),
      .ring_o         (ring),
      .mode_o         (mode),
      .seed_o         (seed),
      .tick_o         (tick),
      .keys_stale_o   (keys_stale),
      .first_slot_o   (first_slot),
      .max_cycles_o   (max_cycles),
      .done_i         (done),
      .cycles_i       (cycles),
      .busy_write_i   (busy_write),
      .busy_doorbell_i(busy_doorbell),
      .torn_i         (torn),
      .untorn_i       (untorn)
  );

  logic obs_done, rewards_done, ters_done, irq_q;

  pearl_sequencer u_sequencer (
      .clk_i,
      .rst_ni,
      .ring_i        (ring),
      .keys_valid_i  (keys_valid),
      .results_done_i(obs_done && rewards_done && ters_done),
      .busy_o        (busy),
      .start_o       (start),
      .done_o        (done),
      .cycles_o      (cycles)
  );

  always_ff @(posedge clk_i or negedge rst_ni) begin
    if (!rst_ni) irq_q <= 1'b0;
    else if (ring) irq_q <= 1'b0;
    else if (done) irq_q <= 1'b1;
  end
  assign irq_o = irq_q;

  // ---- From the host's words to groups: actions, reset bits, random draws ----

  logic issue, issue_last;
  logic [GROUP_BITS-1:0] issue_group;
  logic [31:0] issue_slot;
  logic actions_valid, resets_valid;
  logic [PE_NUM-1:0][ACTION_BITS-1:0] actions;
  logic [PE_NUM-1:0] resets;

  pearl_input_bank #(
      .ROW_BITS(PE_NUM * ACTION_BITS),
      .DATA_WL (DATA_WL),
      .WORDS   (ACTION_WORDS)
  ) u_actions (
      .clk_i,
      .rst_ni,
      .busy_i      (busy),
      .start_i     (start),
      .valid_o     (actions_valid),
      .row_o       (actions),
      .take_i      (issue),
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
      .rst_ni,
      .busy_i      (busy),
      .start_i     (start),
      .valid_o     (resets_valid),
      .row_o       (resets),
      .take_i      (issue),
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
      .REWARD_BITS(REWARD_BITS)
  ) u_group_reader (
      .clk_i,
      .rst_ni,
      .start_i     (start),
      .first_slot_i(first_slot),
      .rows_valid_i(actions_valid && resets_valid),
      .issue_o     (issue),
      .group_o     (issue_group),
      .last_o      (issue_last),
      .slot_o      (issue_slot)
  );

  logic [PE_NUM-1:0][RNG_WORDS-1:0][31:0] rng;
  if (DRAWS == 0) begin : gen_no_draws
    logic unused_draws;
    assign unused_draws = ^{keys_stale, seed, tick, issue_slot};
    assign keys_valid = 1'b1;
    assign rng = '0;
  end else begin : gen_draws
    logic [DRAWS-1:0][31:0] key_a, key_b;

    pearl_rng #(
        .DRAWS(DRAWS)
    ) u_rng (
        .clk_i,
        .rst_ni,
        .restart_i(keys_stale),
        .seed_i   (seed),
        .tick_i   (tick),
        .valid_o  (keys_valid),
        .key_a_o  (key_a),
        .key_b_o  (key_b)
    );

    pearl_draw_row #(
        .PE_NUM(PE_NUM),
        .DRAWS (DRAWS)
    ) u_draw_row (
        .clk_i,
        .slot_i (issue_slot),
        .key_a_i(key_a),
        .key_b_i(key_b),
        .draws_o(rng)
    );
  end

  // ---- Where a group is: read its state, compute, count its elapsed steps, write it back ----

  typedef struct packed {
    logic valid;
    logic last;
    logic [GROUP_BITS-1:0] group;
  } group_t;

  group_t at_read, at_pe, at_count_read, at_count, at_result;
  // At the processing elements only the fact that there is a group matters.
  logic unused_at_pe;
  assign unused_at_pe = ^{at_pe.last, at_pe.group};
  logic [PE_NUM-1:0][ACTION_BITS-1:0] pe_actions;
  logic [PE_NUM-1:0] pe_resets;

  pearl_delay #(
      .WIDTH ($bits(group_t)),
      .STAGES(FETCH - 1)
  ) u_to_read (
      .clk_i,
      .d_i(group_t'{valid: issue, last: issue_last, group: issue_group}),
      .d_o(at_read)
  );
  pearl_delay #(
      .WIDTH ($bits(group_t)),
      .STAGES(1)
  ) u_to_pe (
      .clk_i,
      .d_i(at_read),
      .d_o(at_pe)
  );
  pearl_delay #(
      .WIDTH (PE_NUM * (ACTION_BITS + 1)),
      .STAGES(FETCH)
  ) u_rows_to_pe (
      .clk_i,
      .d_i({actions, resets}),
      .d_o({pe_actions, pe_resets})
  );
  pearl_delay #(
      .WIDTH ($bits(group_t)),
      .STAGES(LATENCY - 1)
  ) u_to_count_read (
      .clk_i,
      .d_i(at_read),
      .d_o(at_count_read)
  );
  pearl_delay #(
      .WIDTH ($bits(group_t)),
      .STAGES(1)
  ) u_to_count (
      .clk_i,
      .d_i(at_count_read),
      .d_o(at_count)
  );
  pearl_delay #(
      .WIDTH ($bits(group_t)),
      .STAGES(1)
  ) u_to_result (
      .clk_i,
      .d_i(at_count),
      .d_o(at_result)
  );

  logic [PE_NUM-1:0][STATE_BITS-1:0] inits;
  logic [PE_NUM-1:0][SLOT_BITS-1:0] states, next_states;
  logic [PE_NUM-1:0][ELAPSED_BITS-1:0] elapsed, next_elapsed;

  pearl_row_memory #(
      .ROWS    (GROUPS),
      .ROW_BITS(PE_NUM * STATE_BITS),
      .DATA_WL (DATA_WL)
  ) u_initial_states (
      .clk_i,
      .busy_i      (busy),
      .re_i        (at_read.valid && mode.stored),
      .raddr_i     (at_read.group),
      .rdata_o     (inits),
      .we_i        (1'b0),
      .waddr_i     ('0),
      .wdata_i     ('0),
      .host_re_i   (host_re[InitialStates]),
      .host_we_i   (host_we[InitialStates]),
      .host_addr_i (host_index[GROUP_BITS+INIT_COLUMNS_LOG2-1:0]),
      .host_wdata_i(host_wdata),
      .host_rdata_o(host_rdata[InitialStates])
  );

  pearl_row_memory #(
      .ROWS    (GROUPS),
      .ROW_BITS(PE_NUM * SLOT_BITS),
      .DATA_WL (DATA_WL)
  ) u_current_states (
      .clk_i,
      .busy_i      (busy),
      .re_i        (at_read.valid),
      .raddr_i     (at_read.group),
      .rdata_o     (states),
      .we_i        (at_result.valid),
      .waddr_i     (at_result.group),
      .wdata_i     (next_states),
      .host_re_i   (host_re[CurrentStates]),
      .host_we_i   (host_we[CurrentStates]),
      .host_addr_i (host_index[GROUP_BITS+STATE_COLUMNS_LOG2-1:0]),
      .host_wdata_i(host_wdata),
      .host_rdata_o(host_rdata[CurrentStates])
  );

  pearl_row_memory #(
      .ROWS    (GROUPS),
      .ROW_BITS(PE_NUM * ELAPSED_BITS),
      .DATA_WL (DATA_WL)
  ) u_elapsed (
      .clk_i,
      .busy_i      (busy),
      .re_i        (at_count_read.valid),
      .raddr_i     (at_count_read.group),
      .rdata_o     (elapsed),
      .we_i        (at_count.valid),
      .waddr_i     (at_count.group),
      .wdata_i     (next_elapsed),
      .host_re_i   (host_re[Elapsed]),
      .host_we_i   (host_we[Elapsed]),
      .host_addr_i (host_index[GROUP_BITS+ELAPSED_COLUMNS_LOG2-1:0]),
      .host_wdata_i(host_wdata),
      .host_rdata_o(host_rdata[Elapsed])
  );

  logic [PE_NUM-1:0][OBS_BITS-1:0] obs;
  logic [PE_NUM-1:0][REWARD_BITS-1:0] rewards;
  logic [PE_NUM-1:0][TER_BITS-1:0] ters;

  pearl_pe_array #(
      .N_ENVS(N_ENVS),
      .PE_NUM(PE_NUM)
  ) u_pe_array (
      .clk_i,
      .rst_ni,
      .valid_i     (at_pe.valid),
      .mode_i      (mode),
      .max_cycles_i(max_cycles),
      .states_i    (states),
      .inits_i     (inits),
      .resets_i    (pe_resets),
      .actions_i   (pe_actions),
      .rng_i       (rng),
      .elapsed_i   (elapsed),
      .elapsed_o   (next_elapsed),
      .valid_late_i(at_result.valid),
      .last_late_i (at_result.last),
      .states_o    (next_states),
      .obs_o       (obs),
      .rewards_o   (rewards),
      .ters_o      (ters)
  );

  // ---- From groups to the host's words: three banks, written in parallel ----

  pearl_result_bank #(
      .ROW_BITS(PE_NUM * OBS_BITS),
      .DATA_WL (DATA_WL),
      .WORDS   (OBS_WORDS)
  ) u_observations (
      .clk_i,
      .rst_ni,
      .start_i     (start),
      .valid_i     (at_result.valid),
      .last_i      (at_result.last),
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
      .rst_ni,
      .start_i     (start),
      .valid_i     (at_result.valid),
      .last_i      (at_result.last),
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
      .rst_ni,
      .start_i     (start),
      .valid_i     (at_result.valid),
      .last_i      (at_result.last),
      .row_i       (ters),
      .done_o      (ters_done),
      .host_re_i   (host_re[Ters]),
      .host_addr_i (host_index[index_bits(TER_WORDS)-1:0]),
      .host_rdata_o(host_rdata[Ters])
  );

endmodule
