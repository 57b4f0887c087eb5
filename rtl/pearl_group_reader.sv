// SPDX-License-Identifier: MIT
// Sends the groups of a step into the pipeline, from the first to the last, as fast as the core's
// initiation interval, the actions and the packers allow.
module pearl_group_reader
  import pearl_pkg::*;
#(
    parameter int unsigned GROUPS = 4,
    parameter int unsigned PE_NUM = 4,
    parameter int unsigned DATA_WL = 32,
    parameter int unsigned II = 1,
    parameter int unsigned OBS_BITS = 6,
    parameter int unsigned REWARD_BITS = 1,
    parameter int unsigned TER_BITS = 2,
    localparam int unsigned GROUP_BITS = index_bits(GROUPS)
) (
    input  logic                  clk_i,
    input  logic                  rst_ni,
    input  logic                  start_i,
    input  logic [          31:0] first_slot_i,
    // The rows of actions and reset bits that the next group needs are there.
    input  logic                  rows_valid_i,
    // A group enters the pipeline; its rows are taken in this cycle.
    output logic                  issue_o,
    output logic [GROUP_BITS-1:0] group_o,
    output logic                  last_o,
    // The global number of the group's first slot.
    output logic [          31:0] slot_o
);

  localparam int unsigned BANKS = 3;
  localparam int unsigned ROW_BITS[BANKS] = '{PE_NUM * OBS_BITS, PE_NUM * REWARD_BITS, PE_NUM * TER_BITS};
  localparam int unsigned WAIT_BITS = index_bits(II);

  logic active_q;
  logic [GROUP_BITS-1:0] group_q;
  logic [WAIT_BITS-1:0] wait_q;
  logic [31:0] slot_q;
  logic [BANKS-1:0] room;

  for (genvar i = 0; i < BANKS; i++) begin : gen_bank
    localparam int unsigned UNIT = common_unit(ROW_BITS[i], DATA_WL);
    localparam int unsigned ROW_UNITS = ROW_BITS[i] / UNIT;
    localparam int unsigned WORD_UNITS = DATA_WL / UNIT;
    logic unused_word;
    logic [index_bits(WORD_UNITS)-1:0] unused_offset;
    pearl_fill #(
        .ROW_UNITS (ROW_UNITS),
        .WORD_UNITS(WORD_UNITS)
    ) u_fill (
        .clk_i,
        .rst_ni,
        .clear_i (start_i),
        .row_i   (issue_o),
        .word_o  (unused_word),
        .offset_o(unused_offset),
        .ready_o (room[i])
    );
  end

  assign issue_o = active_q && rows_valid_i && wait_q == '0 && &room;
  assign group_o = group_q;
  assign last_o  = 32'(group_q) == GROUPS - 1;
  assign slot_o  = slot_q;

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      active_q <= 1'b0;
      group_q  <= '0;
      wait_q   <= '0;
      slot_q   <= '0;
    end else if (start_i) begin
      active_q <= 1'b1;
      group_q  <= '0;
      wait_q   <= '0;
      slot_q   <= first_slot_i;
    end else if (issue_o) begin
      active_q <= !last_o;
      group_q  <= group_q + 1'b1;
      wait_q   <= WAIT_BITS'(II - 1);
      slot_q   <= slot_q + 32'(PE_NUM);
    end else if (wait_q != '0) begin
      wait_q <= wait_q - 1'b1;
    end
  end

endmodule
