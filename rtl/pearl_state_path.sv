// SPDX-License-Identifier: MIT
// The way of a group through its step: its states are read, the cores compute, its elapsed steps are
// counted, and all of it is written back.
//
// Nothing in it can stall. Its delays have no reset, so that they can be shift-register LUTs: who resets it
// waits until it is empty, which takes DEPTH cycles.
module pearl_state_path
  import pearl_pkg::*;
  import pearl_core_pkg::*;
  import pearl_map_pkg::*;
#(
    parameter int unsigned N_ENVS = 7,
    parameter int unsigned PE_NUM = 4,
    parameter int unsigned DATA_WL = 32,
    parameter int unsigned HOST_ADDR_BITS = 14,
    localparam int unsigned GROUPS = ceil_div(N_ENVS, PE_NUM),
    localparam int unsigned GROUP_BITS = index_bits(GROUPS)
) (
    input logic                     clk_i,
    input logic                     rst_ni,
    input logic                     busy_i,
    input mode_t                    mode_i,
    input logic                     limited_i,
    input logic  [ELAPSED_BITS-1:0] limit_i,

    // A group and its rows.
    input logic                                         issue_i,
    input logic                                         last_i,
    // It is only to show what its step starts from: nothing of it is written back.
    input logic                                         observe_i,
    input logic [GROUP_BITS-1:0]                        group_i,
    input logic [    PE_NUM-1:0][ACTION_BITS-1:0]       actions_i,
    input logic [    PE_NUM-1:0]                        resets_i,
    // DRAW_LATENCY cycles later, if there are draws.
    input logic [    PE_NUM-1:0][  RNG_WORDS-1:0][31:0] rng_i,

    // Its results.
    output logic                                    valid_o,
    output logic                                    last_o,
    output logic                                    observe_o,
    output logic [GROUP_BITS-1:0]                   group_o,
    output logic [    PE_NUM-1:0][    OBS_BITS-1:0] obs_o,
    output logic [    PE_NUM-1:0][ REWARD_BITS-1:0] rewards_o,
    output logic [    PE_NUM-1:0][    TER_BITS-1:0] ters_o,
    // Agents that had ended before, and steps of episodes.
    output logic [    PE_NUM-1:0][      AGENTS-1:0] gone_o,
    output logic [    PE_NUM-1:0][ELAPSED_BITS-1:0] elapsed_o,

    // The host's way to the three memories. What it reads comes READ_LATENCY + 1 cycles later; in every other
    // cycle that is zero.
    input  logic [Elapsed:InitialStates] host_re_i,
    input  logic [Elapsed:InitialStates] host_we_i,
    input  logic [   HOST_ADDR_BITS-1:0] host_addr_i,
    input  logic [          DATA_WL-1:0] host_wdata_i,
    output logic [          DATA_WL-1:0] host_rdata_o
);

  typedef struct packed {
    logic valid;
    logic last;
    logic observe;
    logic [GROUP_BITS-1:0] group;
  } group_t;

  // Where a group is: its states are read, at the processing elements, its elapsed steps are read, it
  // has its results.
  group_t at_read, at_pe, at_count, at_result;
  // At the processing elements it does not matter which group it is.
  logic unused_at_pe;
  assign unused_at_pe = ^{at_pe.last, at_pe.group};

  pearl_delay #(
      .WIDTH ($bits(group_t)),
      .STAGES(issue_to_read(DRAWS))
  ) u_to_read (
      .clk_i,
      .d_i(group_t'{valid: issue_i, last: last_i, observe: observe_i, group: group_i}),
      .d_o(at_read)
  );
  pearl_delay #(
      .WIDTH ($bits(group_t)),
      .STAGES(READ_LATENCY)
  ) u_to_pe (
      .clk_i,
      .d_i(at_read),
      .d_o(at_pe)
  );
  // A counter comes out of its memory in the core's last cycle.
  pearl_delay #(
      .WIDTH ($bits(group_t)),
      .STAGES(LATENCY)
  ) u_to_count (
      .clk_i,
      .d_i(at_read),
      .d_o(at_count)
  );
  pearl_delay #(
      .WIDTH ($bits(group_t)),
      .STAGES(READ_LATENCY + 1)
  ) u_to_result (
      .clk_i,
      .d_i(at_count),
      .d_o(at_result)
  );
  assign valid_o = at_result.valid;
  assign last_o = at_result.last;
  assign observe_o = at_result.observe;
  assign group_o = at_result.group;

  logic write_back;
  assign write_back = at_result.valid && !at_result.observe;

  logic [PE_NUM-1:0][ACTION_BITS-1:0] actions;
  logic [PE_NUM-1:0] resets;
  pearl_delay #(
      .WIDTH (PE_NUM * (ACTION_BITS + 1)),
      .STAGES(issue_to_read(DRAWS) + READ_LATENCY)
  ) u_rows (
      .clk_i,
      .d_i({actions_i, resets_i}),
      .d_o({actions, resets})
  );

  // A row memory's words per row are a power of two.
  localparam int unsigned INIT_COLUMNS_LOG2 = $clog2(stream_words(PE_NUM, STATE_BITS, DATA_WL));
  localparam int unsigned STATE_COLUMNS_LOG2 = $clog2(stream_words(PE_NUM, SLOT_BITS, DATA_WL));
  localparam int unsigned ELAPSED_COLUMNS_LOG2 = $clog2(stream_words(PE_NUM, ELAPSED_BITS, DATA_WL));
  // No region is as long as the map.
  logic unused_addr;
  assign unused_addr = ^host_addr_i;

  logic [PE_NUM-1:0][STATE_BITS-1:0] inits;
  logic [PE_NUM-1:0][SLOT_BITS-1:0] states, next_states;
  logic [PE_NUM-1:0][ELAPSED_BITS-1:0] elapsed, next_elapsed;
  assign elapsed_o = next_elapsed;

  logic [Elapsed:InitialStates][DATA_WL-1:0] host_rdata;
  logic [DATA_WL-1:0] host_rdata_q;
  always_ff @(posedge clk_i) begin
    host_rdata_q <= host_rdata[InitialStates] | host_rdata[CurrentStates] | host_rdata[Elapsed];
  end
  assign host_rdata_o = host_rdata_q;

  pearl_row_memory #(
      .ROWS    (GROUPS),
      .ROW_BITS(PE_NUM * STATE_BITS),
      .DATA_WL (DATA_WL)
  ) u_initial_states (
      .clk_i,
      .busy_i,
      .re_i        (at_read.valid && mode_i.stored),
      .raddr_i     (at_read.group),
      .rdata_o     (inits),
      .we_i        (1'b0),
      .waddr_i     ('0),
      .wdata_i     ('0),
      .host_re_i   (host_re_i[InitialStates]),
      .host_we_i   (host_we_i[InitialStates]),
      .host_addr_i (host_addr_i[GROUP_BITS+INIT_COLUMNS_LOG2-1:0]),
      .host_wdata_i,
      .host_rdata_o(host_rdata[InitialStates])
  );

  pearl_row_memory #(
      .ROWS    (GROUPS),
      .ROW_BITS(PE_NUM * SLOT_BITS),
      .DATA_WL (DATA_WL)
  ) u_current_states (
      .clk_i,
      .busy_i,
      .re_i        (at_read.valid),
      .raddr_i     (at_read.group),
      .rdata_o     (states),
      .we_i        (write_back),
      .waddr_i     (at_result.group),
      .wdata_i     (next_states),
      .host_re_i   (host_re_i[CurrentStates]),
      .host_we_i   (host_we_i[CurrentStates]),
      .host_addr_i (host_addr_i[GROUP_BITS+STATE_COLUMNS_LOG2-1:0]),
      .host_wdata_i,
      .host_rdata_o(host_rdata[CurrentStates])
  );

  pearl_row_memory #(
      .ROWS    (GROUPS),
      .ROW_BITS(PE_NUM * ELAPSED_BITS),
      .DATA_WL (DATA_WL)
  ) u_elapsed (
      .clk_i,
      .busy_i,
      .re_i        (at_count.valid),
      .raddr_i     (at_count.group),
      .rdata_o     (elapsed),
      .we_i        (write_back),
      .waddr_i     (at_result.group),
      .wdata_i     (next_elapsed),
      .host_re_i   (host_re_i[Elapsed]),
      .host_we_i   (host_we_i[Elapsed]),
      .host_addr_i (host_addr_i[GROUP_BITS+ELAPSED_COLUMNS_LOG2-1:0]),
      .host_wdata_i,
      .host_rdata_o(host_rdata[Elapsed])
  );

  pearl_pe_array #(
      .N_ENVS(N_ENVS),
      .PE_NUM(PE_NUM)
  ) u_pe_array (
      .clk_i,
      .rst_ni,
      .valid_i     (at_pe.valid),
      .observe_i   (at_pe.observe),
      .mode_i,
      .limited_i,
      .limit_i,
      .states_i    (states),
      .inits_i     (inits),
      .resets_i    (resets),
      .actions_i   (actions),
      .rng_i,
      .elapsed_i   (elapsed),
      .elapsed_o   (next_elapsed),
      .valid_late_i(at_result.valid),
      .last_late_i (at_result.last),
      .states_o    (next_states),
      .obs_o,
      .rewards_o,
      .ters_o,
      .gone_o
  );

endmodule
