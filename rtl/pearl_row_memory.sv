// SPDX-License-Identifier: MIT
// A memory of one row of slots per group, which the pipeline reads and writes a row a cycle and the
// host a word at a time.
//
// To the host a row is COLUMNS words, rounded up to a power of two so that an address splits into row
// and column without a division; what lies beyond the row's bits reads as zero and takes no writes.
// Host and pipeline share the ports: the host is served only while busy_i is low. Both get what they read
// READ_LATENCY cycles later, and the host gets zero in every other cycle.
module pearl_row_memory
  import pearl_pkg::*;
#(
    parameter int unsigned ROWS = 4,
    parameter int unsigned ROW_BITS = 48,
    parameter int unsigned DATA_WL = 32,
    localparam int unsigned COLUMNS = ceil_div(ROW_BITS, DATA_WL),
    localparam int unsigned COLUMN_BITS = index_bits(COLUMNS),
    localparam int unsigned ROW_INDEX_BITS = index_bits(ROWS),
    localparam int unsigned HOST_ADDR_BITS = $clog2(COLUMNS) + ROW_INDEX_BITS
) (
    input logic clk_i,
    input logic busy_i,

    input  logic                      re_i,
    input  logic [ROW_INDEX_BITS-1:0] raddr_i,
    output logic [      ROW_BITS-1:0] rdata_o,
    input  logic                      we_i,
    input  logic [ROW_INDEX_BITS-1:0] waddr_i,
    input  logic [      ROW_BITS-1:0] wdata_i,

    input  logic                      host_re_i,
    input  logic                      host_we_i,
    input  logic [HOST_ADDR_BITS-1:0] host_addr_i,
    input  logic [       DATA_WL-1:0] host_wdata_i,
    output logic [       DATA_WL-1:0] host_rdata_o
);

  logic [ROW_INDEX_BITS-1:0] host_row, raddr, waddr;
  logic [COLUMN_BITS-1:0] host_column, column;
  logic re;

  assign host_row = host_addr_i[HOST_ADDR_BITS-1-:ROW_INDEX_BITS];
  if (COLUMNS > 1) begin : gen_columns
    assign host_column = host_addr_i[COLUMN_BITS-1:0];
  end else begin : gen_column
    assign host_column = '0;
  end

  // The last word of a row may not be full.
  logic unused_wdata;
  assign unused_wdata = ^host_wdata_i;

  assign re = busy_i ? re_i : host_re_i;
  assign raddr = busy_i ? raddr_i : host_row;
  assign waddr = busy_i ? waddr_i : host_row;

  logic asked;
  pearl_delay #(
      .WIDTH (COLUMN_BITS + 1),
      .STAGES(READ_LATENCY - 1)
  ) u_column (
      .clk_i,
      .d_i({host_re_i && !busy_i, host_column}),
      .d_o({asked, column})
  );

  // A row may have dozens of columns, all over the FPGA: their words are only masked and put together.
  logic [COLUMNS-1:0] chosen_q;
  always_ff @(posedge clk_i) begin
    for (int unsigned i = 0; i < COLUMNS; i++) begin
      chosen_q[i] <= asked && column == COLUMN_BITS'(i);
    end
  end

  logic [COLUMNS-1:0][DATA_WL-1:0] words;
  for (genvar i = 0; i < COLUMNS; i++) begin : gen_column_rams
    localparam int unsigned WIDTH = (i + 1) * DATA_WL > ROW_BITS ? ROW_BITS - i * DATA_WL : DATA_WL;
    logic we;
    assign we = busy_i ? we_i : host_we_i && host_column == COLUMN_BITS'(i);
    pearl_ram #(
        .WIDTH(WIDTH),
        .DEPTH(ROWS)
    ) u_ram (
        .clk_i,
        .we_i(we),
        .waddr_i(waddr),
        .wdata_i(busy_i ? wdata_i[i*DATA_WL+:WIDTH] : host_wdata_i[WIDTH-1:0]),
        .re_i(re),
        .raddr_i(raddr),
        .rdata_o(rdata_o[i*DATA_WL+:WIDTH])
    );
    assign words[i] = DATA_WL'(rdata_o[i*DATA_WL+:WIDTH]);
  end

  always_comb begin
    host_rdata_o = '0;
    for (int unsigned i = 0; i < COLUMNS; i++) begin
      if (chosen_q[i]) host_rdata_o |= words[i];
    end
  end

endmodule
